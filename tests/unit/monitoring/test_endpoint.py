"""The HTTP side on a real socket, and `ua-fleet healthcheck` as its client."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import AsyncGenerator, Awaitable, Callable
from pathlib import Path

import pytest

from tests.system import clean_environment
from ua_fleet.cli import health
from ua_fleet.cli.health import HealthQuestion, HealthVerdict, check
from ua_fleet.errors import ServerStartError
from ua_fleet.monitoring import Monitor, ProcessKind, endpoint
from ua_fleet.monitoring.address import ADDRESS_FILE, remove_address, write_address
from ua_fleet.monitoring.endpoint import MonitoringEndpoint

Send = Callable[[bytes], Awaitable[bytes]]


@pytest.fixture
def monitor() -> Monitor:
    return Monitor(ProcessKind.SERVER, "Hall")


@pytest.fixture
async def listening(monitor: Monitor, tmp_path: Path) -> AsyncGenerator[MonitoringEndpoint]:
    async with MonitoringEndpoint(monitor, "127.0.0.1", 0, tmp_path / "state", key="monitoring.port") as made:
        yield made


@pytest.fixture
def send(listening: MonitoringEndpoint) -> Send:
    """Send bytes, and take all that comes until the connection ends."""

    async def sent(data: bytes) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", listening.port)
        try:
            writer.write(data)
            answer = b""
            async with asyncio.timeout(60):
                while part := await reader.read(65536):
                    answer += part
            return answer
        finally:
            writer.close()

    return sent


async def ask(asked: HealthQuestion) -> HealthVerdict:
    return await asyncio.to_thread(check, asked)


def get(path: str, method: str = "GET", more: str = "") -> bytes:
    return f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n{more}\r\n".encode()


async def test_healthz_answers_before_the_process_is_ready(send: Send) -> None:
    head, _, body = (await send(get("/healthz"))).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200 OK\r\n")
    assert body == b"ok\n"


@pytest.mark.parametrize("host", ["evil.example", "evil.example:9464", "127.0.0.1.evil.example", "xlocalhost", ""])
async def test_a_foreign_name_gets_nothing(send: Send, host: str) -> None:
    """A web page may have its own name lead to this machine, and read what a process tells."""
    for path in ("/metrics", "/readyz", "/healthz"):
        answer = await send(f"GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        assert answer.startswith(b"HTTP/1.1 421 Misdirected Request\r\n")
        assert b"monitoring.names" in answer


@pytest.mark.parametrize(
    "host",
    ["127.0.0.1", "10.1.2.3:9464", "[::1]:9464", "LOCALHOST:1", "localhost.", socket.gethostname(), "Plant-7:80"],
)
async def test_its_own_names_are_answered(monitor: Monitor, tmp_path: Path, host: str) -> None:
    async with MonitoringEndpoint(monitor, "127.0.0.1", 0, tmp_path, key="k", names=("plant-7",)) as made:
        reader, writer = await asyncio.open_connection("127.0.0.1", made.port)
        writer.write(f"GET /healthz HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        assert (await reader.readline()) == b"HTTP/1.1 200 OK\r\n"
        writer.close()
        await writer.wait_closed()


async def test_readyz_follows_the_process(send: Send, monitor: Monitor) -> None:
    answer = await send(get("/readyz"))
    assert answer.startswith(b"HTTP/1.1 503 Service Unavailable\r\n")
    assert answer.endswith(b"\r\n\r\nnot ready: it is starting\n")
    problem = ""
    monitor.ready_when(lambda: problem, lambda: "as ever")
    assert (await send(get("/readyz"))).endswith(b"\r\n\r\nready: as ever\n")
    problem = "two\nlines"
    assert (await send(get("/readyz?verbose"))).endswith(b"\r\n\r\nnot ready: two lines\n")


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (get("/"), b"404 Not Found"),
        (get("/metrics", "POST", "Content-Length: 1\r\n"), b"405 Method Not Allowed"),
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(200) + b"\r\n\r\n", b"400 Bad Request"),
        (b"GET /metrics\r\n\r\n", b"400 Bad Request"),
        (b"HELO there\r\n\r\n", b"400 Bad Request"),
        (get("/metrics", more=f"X: {'y' * 20_000}\r\n"), b"431 Request Header Fields Too Large"),
        (b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nHost: localhost\r\n\r\n", b"400 Bad Request"),
    ],
    ids=["path", "method", "tls", "http 0.9", "smtp", "too long", "two hosts"],
)
async def test_what_is_no_good_request_is_answered_in_one_line(send: Send, request_: bytes, status: bytes) -> None:
    answer = await send(request_)
    assert answer.startswith(b"HTTP/1.1 " + status + b"\r\n")
    assert answer.partition(b"\r\n\r\n")[2].count(b"\n") == 1
    assert (await send(get("/healthz"))).startswith(b"HTTP/1.1 200")


async def test_head_has_no_body(send: Send) -> None:
    head, _, body = (await send(get("/metrics", "HEAD"))).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200")
    assert int(head.lower().partition(b"content-length: ")[2].partition(b"\r\n")[0]) > 1000
    assert body == b""


async def test_the_oldest_connection_makes_room(send: Send, listening: MonitoringEndpoint) -> None:
    """Whoever opens connections and says nothing keeps nobody else from asking."""
    idle = [await asyncio.open_connection("127.0.0.1", listening.port) for _ in range(endpoint.MOST_CONNECTIONS + 5)]
    try:
        for _ in range(3):
            assert (await send(get("/healthz"))).startswith(b"HTTP/1.1 200")
        async with asyncio.timeout(endpoint.PATIENCE_S / 2):
            with contextlib.suppress(ConnectionError):
                assert await idle[0][0].read() == b""
    finally:
        for _, writer in idle:
            writer.close()


async def test_a_client_that_is_slow_is_let_go(listening: MonitoringEndpoint, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(endpoint, "PATIENCE_S", 0.3)
    reader, writer = await asyncio.open_connection("127.0.0.1", listening.port)
    began = time.monotonic()
    writer.write(b"GET /metrics HTTP/1.1\r\nHost: ")
    async with asyncio.timeout(5):
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
    assert 0.2 < time.monotonic() - began < 3
    writer.close()


async def test_closing_waits_for_nobody(monitor: Monitor, tmp_path: Path) -> None:
    async with MonitoringEndpoint(monitor, "127.0.0.1", 0, tmp_path, key="monitoring.port") as made:
        _, writer = await asyncio.open_connection("127.0.0.1", made.port)
        await asyncio.sleep(0.05)
        began = time.monotonic()
    assert time.monotonic() - began < 1
    writer.close()


async def test_a_port_in_use_is_one_line_with_the_remedy(
    monitor: Monitor, listening: MonitoringEndpoint, tmp_path: Path
) -> None:
    second = MonitoringEndpoint(monitor, "127.0.0.1", listening.port, tmp_path, key="server.monitoring_port")
    with pytest.raises(ServerStartError) as caught:
        await second.__aenter__()
    assert str(caught.value) == (
        f"health and metrics cannot be served at 127.0.0.1:{listening.port} (address already in use); "
        "set server.monitoring_port to a free port or 0, and monitoring.host to an address of this machine"
    )


async def test_an_address_of_another_machine_is_one_line_too(monitor: Monitor, tmp_path: Path) -> None:
    with pytest.raises(ServerStartError, match=r"192\.0\.2\.1:9464 \(cannot assign requested address\); set "):
        await MonitoringEndpoint(monitor, "192.0.2.1", 9464, tmp_path, key="monitoring.port").__aenter__()


async def test_lag_of_the_loop_is_seen(monitor: Monitor, listening: MonitoringEndpoint) -> None:
    await asyncio.sleep(0.9)
    time.sleep(0.6)
    await asyncio.sleep(0.1)
    text = monitor.exposition()[0].decode()
    assert 'ua_fleet_loop_lag_seconds_bucket{le="0.1"} 0.0' in text
    assert 'ua_fleet_loop_lag_seconds_bucket{le="1.0"} 1.0' in text
    assert listening.port


# The file with the address.


async def test_a_process_is_found_by_its_folder(listening: MonitoringEndpoint, tmp_path: Path) -> None:
    state = tmp_path / "state"
    assert json.loads((state / ADDRESS_FILE).read_text())["port"] == listening.port
    assert state.stat().st_mode & 0o777 == 0o700
    assert await ask(HealthQuestion(state_dir=str(state), live=True)) == (True, "ok")
    assert await ask(HealthQuestion(state_dir=str(state))) == (False, "not ready: it is starting")
    assert await ask(HealthQuestion(at=f"127.0.0.1:{listening.port}")) == (False, "not ready: it is starting")


async def test_after_the_end_there_is_no_file(monitor: Monitor, tmp_path: Path) -> None:
    async with MonitoringEndpoint(monitor, "127.0.0.1", 0, tmp_path, key="monitoring.port"):
        assert (tmp_path / ADDRESS_FILE).exists()
    assert list(tmp_path.iterdir()) == []
    is_well, text = await ask(HealthQuestion(state_dir=str(tmp_path)))
    assert not is_well
    assert text == (
        f"{tmp_path / ADDRESS_FILE}: no such file or directory; check that the process runs, with monitoring.enabled"
    )


async def test_another_process_at_the_port_of_one_that_was_killed(
    listening: MonitoringEndpoint, tmp_path: Path
) -> None:
    write_address(tmp_path, "127.0.0.1", listening.port, "gone")
    assert (await ask(HealthQuestion(state_dir=str(tmp_path), live=True))).text == (
        f"another process answers at 127.0.0.1:{listening.port}; the process of this state_dir has ended"
    )
    remove_address(tmp_path, "another")
    assert (tmp_path / ADDRESS_FILE).exists()


def test_both_sides_name_the_same_file() -> None:
    assert health.ADDRESS_FILE == ADDRESS_FILE


# Whoever answers badly, or not at all.


@pytest.mark.parametrize(
    "asked", [HealthQuestion(at="here"), HealthQuestion(at="127.0.0.1:0"), HealthQuestion(tcp="127.0.0.1:99999")]
)
def test_an_address_that_is_none(asked: HealthQuestion) -> None:
    place = asked.at or asked.tcp
    assert check(asked) == (False, f"{place} is no address; write it as HOST:PORT")


def test_nobody_there() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = f"127.0.0.1:{probe.getsockname()[1]}"
        assert check(HealthQuestion(at=place)) == (
            False,
            f"no answer at {place}: connection refused; check that the process runs",
        )
        assert check(HealthQuestion(tcp=place)) == (
            False,
            f"nothing accepts connections at {place}: connection refused",
        )
        probe.listen()
        assert check(HealthQuestion(tcp=place)) == (True, f"{place} accepts connections")


def test_something_else_answers() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        place = f"127.0.0.1:{listener.getsockname()[1]}"
        asking = subprocess.Popen(
            [sys.executable, "-m", "ua_fleet.cli", "healthcheck", "--at", place],
            stdout=subprocess.PIPE,
            text=True,
            env=clean_environment(),
        )
        connection, _ = listener.accept()
        with connection:
            connection.recv(1000)
            connection.sendall(b"SSH-2.0-OpenSSH_9.2\r\n")
        out, _ = asking.communicate(timeout=20)
    assert (asking.returncode, out) == (1, f"what answers at {place} is no ua-fleet process\n")


def test_a_heartbeat(tmp_path: Path) -> None:
    beat = tmp_path / "beat"
    assert check(HealthQuestion(heartbeat=str(beat))) == (
        False,
        f"{beat}: no such file or directory; check that the program has started",
    )
    beat.touch()
    is_well, text = check(HealthQuestion(heartbeat=str(beat), within_s=5))
    assert is_well
    assert text.startswith(f"{beat} was touched 0.")
    os.utime(beat, (time.time() - 60, time.time() - 60))
    is_well, text = check(HealthQuestion(heartbeat=str(beat), within_s=5))
    assert not is_well
    assert text.endswith(" s ago, more than 5 s: the program does not work")


BLOCKED = """
import asyncio, sys, time
from pathlib import Path
from ua_fleet.cli.logs import set_up_logging
from ua_fleet.monitoring import Monitor, ProcessKind
from ua_fleet.monitoring.endpoint import MonitoringEndpoint

async def main():
    async with MonitoringEndpoint(Monitor(ProcessKind.SERVER), "127.0.0.1", 0, Path(sys.argv[1]), key="k"):
        print("up", flush=True)
        await asyncio.to_thread(sys.stdin.readline)
        time.sleep(3)
        print("over", flush=True)
        await asyncio.to_thread(sys.stdin.readline)

set_up_logging()
asyncio.run(main())
"""


def test_a_blocked_event_loop_is_unwell_and_then_well_again(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", BLOCKED, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        assert child.stdout.readline() == "up\n"
        asked = HealthQuestion(state_dir=str(tmp_path), live=True, timeout_s=1.0)
        assert check(asked) == (True, "ok")
        child.stdin.write("\n")
        child.stdin.flush()
        deadline = time.monotonic() + 2
        while (verdict := check(asked)).is_well and time.monotonic() < deadline:
            pass
        assert verdict.text.endswith("did not answer within 1 s: its event loop is blocked, or the machine is busy")
        assert child.stdout.readline() == "over\n"
        assert check(HealthQuestion(state_dir=str(tmp_path), live=True)) == (True, "ok")
        child.stdin.write("\n")
        child.stdin.flush()


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "ua_fleet.cli", "healthcheck", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env=clean_environment(),
    )


def test_the_command_needs_nothing_of_the_rest(tmp_path: Path) -> None:
    """Twenty containers ask every ten seconds, on two small cores."""
    ended = run("--state-dir", str(tmp_path), "--json")
    assert ended.returncode == 1
    assert json.loads(ended.stdout)["well"] is False
    loaded = {line.rpartition("|")[2].strip() for line in ended.stderr.splitlines()}
    assert "ua_fleet.cli.health" in loaded
    heavy = {"pydantic", "typer", "click", "rich", "asyncio", "structlog", "yaml", "argparse"}
    assert loaded & heavy == set()
