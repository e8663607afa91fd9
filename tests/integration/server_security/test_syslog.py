"""The copy of the audit log at a syslog server: rsyslog over TLS, and listeners of the test's own."""

from __future__ import annotations

import contextlib
import ipaddress
import json
import shutil
import socket
import ssl
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import NameOID

from tests.integration.server_security.harness import Identities, bad, door
from tests.system import free_tcp_port
from ua_fleet.endpoint.audit import AuditLog, Caller
from ua_fleet.endpoint.audit.syslog_message import Destination
from ua_fleet.endpoint.audit.syslog_sender import SyslogSender, tls_context
from ua_fleet.errors import ServerStartError

ANNA = Caller("10.0.0.7:5000", "anna", "operator")


@pytest.fixture(scope="module")
def peer(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Certificate, its own authority, and key of a syslog server at 127.0.0.1."""
    folder = tmp_path_factory.mktemp("syslog")
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "syslog")])
    now = datetime.now(UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    files = folder / "syslog.pem", folder / "syslog-key.pem"
    files[0].write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    files[1].write_bytes(private)
    return files


class Listener:
    """A syslog server that takes frames, over TLS or not, until it is told to stop."""

    def __init__(self, context: ssl.SSLContext | None = None, port: int = 0) -> None:
        self._context = context
        self._server = socket.create_server(("127.0.0.1", port))
        self.port = int(self._server.getsockname()[1])
        self.messages: list[bytes] = []
        self._open: list[socket.socket] = []
        self._thread = threading.Thread(target=self._accept, daemon=True)
        self._thread.start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                accepted, _ = self._server.accept()
                with contextlib.suppress(OSError):
                    stream = self._context.wrap_socket(accepted, server_side=True) if self._context else accepted
                    self._open.append(stream)
                    self._take(stream)

    def _take(self, stream: socket.socket) -> None:
        data = b""
        while part := stream.recv(65_536):
            data += part
            while b" " in data and len(data) >= (end := data.index(b" ") + 1 + int(data[: data.index(b" ")])):
                self.messages.append(data[data.index(b" ") + 1 : end])
                data = data[end:]

    def stop(self) -> None:
        for each in (*self._open, self._server):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()
        self._thread.join(20)

    def records(self) -> list[dict[str, Any]]:
        """The lines of the log, out of their messages."""
        return [json.loads(message.split(b" ", 7)[7]) for message in self.messages]


def server_context(peer: tuple[Path, Path]) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*peer)
    return context


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.fixture
def listener(peer: tuple[Path, Path]) -> Iterator[Listener]:
    made = Listener(server_context(peer))
    yield made
    made.stop()


async def test_a_server_sends_what_it_writes(
    tmp_path: Path, identities: Identities, listener: Listener, peer: tuple[Path, Path]
) -> None:
    syslog = {"url": f"tls://127.0.0.1:{listener.port}", "ca_file": str(peer[0])}
    async with door(tmp_path, identities, audit={"syslog": syslog}) as running, running.connected() as client:
        await client.get_node(running.nodes.value).write_value(2.5)
        assert await bad(client.get_node(running.nodes.plain).write_value(2.5)) == "BadNotWritable"
    until(lambda: len(listener.messages) >= 4)
    written = [json.loads(line) for line in (tmp_path / "state" / "audit.log").read_text().splitlines()]
    assert listener.records() == written, "the numbers and hashes too: the copy is an anchor of every line"
    assert [message[:6] for message in listener.messages] == [b"<110>1", b"<110>1", b"<108>1", b"<110>1"]
    assert [line["event"] for line in written] == ["login", "write", "write", "logout"]


def test_a_server_that_is_away_gets_the_lines_later(tmp_path: Path, peer: tuple[Path, Path]) -> None:
    port = free_tcp_port()
    sender = SyslogSender(Destination("tls", "127.0.0.1", port), tls_context(peer[0], None, None))
    log = AuditLog(tmp_path / "audit.log", copy=sender)
    for number in range(5):
        log.record("write", ANNA, "Good", node=str(number))
    first = Listener(server_context(peer), port)
    until(lambda: len(first.messages) == 5)
    first.stop()
    second = Listener(server_context(peer), port)
    until(lambda: log.record("write", ANNA, "Good") and second.messages)
    log.close()
    seen = [record["seq"] for record in (*first.records(), *second.records())]
    assert seen[:5] == [1, 2, 3, 4, 5]
    assert seen == sorted(set(seen))
    assert sender.dropped == 0
    second.stop()


@pytest.mark.parametrize("wrong", ["authority", "name"])
def test_a_syslog_server_that_proves_nothing_gets_nothing(tmp_path: Path, peer: tuple[Path, Path], wrong: str) -> None:
    listener = Listener(server_context(peer))
    context = tls_context(peer[0] if wrong == "name" else None, None, None)
    host = "localhost" if wrong == "name" else "127.0.0.1"
    sender = SyslogSender(Destination("tls", host, listener.port), context)
    log = AuditLog(tmp_path / "audit.log", copy=sender)
    log.record("write", ANNA, "Good")
    until(lambda: sender.is_away)
    log.close()
    assert (listener.messages, log.undelivered) == ([], 1)
    listener.stop()


def test_a_stream_in_plain_text(tmp_path: Path) -> None:
    stream = Listener()
    log = AuditLog(tmp_path / "audit.log", copy=SyslogSender(Destination("tcp", "127.0.0.1", stream.port)))
    log.record("write", ANNA, "Good", node="n1")
    until(lambda: stream.messages)
    log.close()
    stream.stop()
    assert stream.records()[0]["node"] == "n1"


@pytest.mark.parametrize("scheme", ["udp", "unix"])
def test_datagrams(tmp_path: Path, scheme: str) -> None:
    path = str(tmp_path / "log")
    with socket.socket(socket.AF_UNIX if scheme == "unix" else socket.AF_INET, socket.SOCK_DGRAM) as local:
        local.settimeout(20)
        local.bind(path if scheme == "unix" else ("127.0.0.1", 0))
        port = 0 if scheme == "unix" else int(local.getsockname()[1])
        to = Destination("unix", path=path) if scheme == "unix" else Destination("udp", "127.0.0.1", port)
        log = AuditLog(tmp_path / "state" / "audit.log", copy=SyslogSender(to))
        log.record("write", ANNA, "Good", node="n1")
        message = local.recv(65_536)
        log.close()
    assert message.startswith(b"<110>1 20")
    assert json.loads(message.split(b" ", 7)[7])["node"] == "n1"


def test_what_waits_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ua_fleet.endpoint.audit.syslog_sender.MOST_WAITING", 10)
    sender = SyslogSender(Destination("tcp", "127.0.0.1", free_tcp_port()))
    for number in range(15):
        sender.put(b"{}", str(number), refused=False)
    assert sender.dropped == 5
    began = time.monotonic()
    until(lambda: sender.is_away)
    sender.close()
    assert (sender.dropped, time.monotonic() - began < 10) == (15, True)


def test_files_that_are_no_certificates_stop_the_start(tmp_path: Path) -> None:
    with pytest.raises(ServerStartError, match=r"server.audit.syslog: .*ca.pem: cannot be used for TLS"):
        tls_context(tmp_path / "ca.pem", None, None)


@pytest.mark.skipif(shutil.which("rsyslogd") is None, reason="rsyslogd (Debian: rsyslog, rsyslog-openssl) is missing")
def test_rsyslog_understands_it(tmp_path: Path, peer: tuple[Path, Path]) -> None:
    """rsyslog's own parser of RFC 5424, its TLS and its framing."""
    port, out = free_tcp_port(), tmp_path / "out"
    plugins = list(Path("/usr/lib").glob("**/rsyslog/lmnsd_ossl.so"))
    if not plugins:
        pytest.skip("rsyslog-openssl is not installed")
    (tmp_path / "rsyslog.conf").write_text(f"""
global(workDirectory="{tmp_path}" defaultNetstreamDriver="ossl" defaultNetstreamDriverCAFile="{peer[0]}"
       defaultNetstreamDriverCertFile="{peer[0]}" defaultNetstreamDriverKeyFile="{peer[1]}")
module(load="imtcp" streamDriver.name="ossl" streamDriver.mode="1" streamDriver.authMode="anon")
input(type="imtcp" port="{port}" address="127.0.0.1")
template(name="parts" type="string"
         string="%protocol-version%|%syslogfacility-text%|%syslogseverity-text%|%app-name%|%msgid%|%msg%\\n")
action(type="omfile" file="{out}" template="parts")
""")
    command = ["rsyslogd", "-n", "-f", str(tmp_path / "rsyslog.conf"), "-i", str(tmp_path / "pid")]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        sender = SyslogSender(Destination("tls", "127.0.0.1", port), tls_context(peer[0], None, None))
        log = AuditLog(tmp_path / "state" / "audit.log", copy=sender)
        log.record("write", ANNA, "Good", node="n1")
        log.refuse(Caller("10.0.0.9:1"), "login", "BadUserAccessDenied", reason="x" * 3_000)
        until(lambda: out.exists() and out.read_text().count("\n") == 2)
        log.close()
    finally:
        process.terminate()
        process.wait(60)
    lines = (tmp_path / "state" / "audit.log").read_text().splitlines()
    assert out.read_text().splitlines() == [
        f"1|audit|info|ua-fleet|write|{lines[0]}",
        f"1|audit|warning|ua-fleet|refusal|{lines[1]}",
    ]
