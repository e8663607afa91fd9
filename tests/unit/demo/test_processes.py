"""Processes of a demonstration: what is said of one that ends, and that none is left."""

from __future__ import annotations

import asyncio
import os
import socket
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from ua_demo.processes import DemoFailed, Processes, free_loopback_address, free_tcp_port

ENDLESS = "import time; print('ready', flush=True); time.sleep(600)"


async def ended(folder: Path, program: str) -> str:
    """What is said of a process that does this."""
    async with Processes(folder) as processes:
        await processes.start("robot", [sys.executable, "-c", program], os.environ)
        with pytest.raises(DemoFailed) as failed:
            await processes.line_with("robot", "ready", 20)
    return str(failed.value)


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("raise SystemExit('no port')", "robot ended with code 1: no port"),
        ("import json; print(json.dumps({'event': 'no key', 'level': 'error'}))", "robot ended with code 0: no key"),
        ("print('{broken')", "robot ended with code 0: {broken"),
        ("import os; os.kill(os.getpid(), 9)", "robot was ended by SIGKILL"),
    ],
)
async def test_who_ended_and_where_its_log_is(tmp_path: Path, program: str, said: str) -> None:
    assert await ended(tmp_path, program) == f"{said}; see {tmp_path / 'robot.log'}"


async def test_a_process_that_says_much_is_kept_in_bounds(tmp_path: Path) -> None:
    program = "print(*range(5000), sep='\\n', flush=True); " + ENDLESS
    async with Processes(tmp_path) as processes:
        await processes.start("robot", [sys.executable, "-c", program], os.environ)
        assert await processes.line_with("robot", "ready", 20) == "ready"
        assert await processes.line_with("robot", "4999", 20) == "4999"
        with pytest.raises(DemoFailed, match="robot is not ready after 0 s"):
            await processes.line_with("robot", "3999", 0.05)
    assert len((tmp_path / "robot.log").read_text().splitlines()) == 5001


async def test_all_are_ended_side_by_side(tmp_path: Path) -> None:
    async with Processes(tmp_path) as processes:
        pids: list[int] = []
        for name in ("one", "two"):
            program = f"import os; print(os.getpid(), flush=True)\n{ENDLESS}"
            await processes.start(name, [sys.executable, "-c", program], os.environ)
            await processes.line_with(name, "ready", 20)
            pids.append(int((tmp_path / f"{name}.log").read_text().split()[0]))
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


async def test_a_port_that_nobody_listens_on_is_waited_for_and_named(tmp_path: Path) -> None:
    port = free_tcp_port(0)
    serve = f"import socket, time; s = socket.create_server(('127.0.0.1', {port})); time.sleep(600)"
    async with Processes(tmp_path) as processes:
        await processes.start("master", [sys.executable, "-c", serve], os.environ)
        await processes.listening("master", port, 20)
        with pytest.raises(DemoFailed, match=r"^master does not listen after 0 s; see .*master\.log$"):
            await processes.listening("master", free_tcp_port(0), 0.1)


async def test_what_does_not_come_in_time_is_named(tmp_path: Path) -> None:
    async with Processes(tmp_path) as processes:
        with pytest.raises(DemoFailed, match=r"^waited 0 s for the robots; see the logs in "):
            await processes.until(lambda: False, asyncio.Event(), 0.1, "the robots")


def test_a_free_port_is_none_that_the_system_gives_to_a_connection_and_each_is_given_out_once() -> None:
    first = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    ports = [free_tcp_port(0) for _ in range(50)]
    assert max(ports) < first
    assert len(set(ports)) == 50
    with socket.create_server(("127.0.0.1", ports[0])):
        assert free_tcp_port(ports[0]) not in ports
    assert free_tcp_port(ports[0]) == ports[0]


def test_a_process_that_is_forked_off_draws_ports_of_its_own() -> None:
    """Two demonstrations that tests start side by side would else take the same."""
    program = (
        "import os; from ua_demo.processes import free_tcp_port; os.fork(); print([free_tcp_port(0) for _ in range(9)])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert len(set(done.stdout.splitlines())) == 2


def test_an_address_with_all_ports_free_is_found() -> None:
    ports = (free_tcp_port(0), free_tcp_port(0))
    taken = free_loopback_address(ports)
    with socket.create_server((taken, ports[1])):
        assert free_loopback_address(ports) not in ("127.0.0.1", taken)


def test_an_address_is_looked_for_from_where_it_is_asked_for() -> None:
    ports = (free_tcp_port(0),)
    assert free_loopback_address(ports, 254) == "127.0.0.254"
    with socket.create_server(("127.0.0.254", ports[0])):
        assert free_loopback_address(ports, 254) == "127.0.0.2"


def test_a_port_that_is_taken_on_all_addresses_is_named() -> None:
    port = free_tcp_port(0)
    with ExitStack() as held:
        for number in range(2, 255):
            held.enter_context(socket.create_server((f"127.0.0.{number}", port)))
        with pytest.raises(DemoFailed, match=f"{port} is in use; end the program that listens there"):
            free_loopback_address((port,))
