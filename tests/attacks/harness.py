"""A real server process under attack, a victim that reads from it, and what the attack did to both.

    with attacked(tmp_path) as server:                 # `ua-fleet serve` as a process; `server.port`, `server.pid`
        with server.harm() as harm:                    # a victim on 127.0.0.2 reads every 0.1 s from here on
            with server.connected() as attacker:       # a raw connection: Hello and OpenSecureChannel are done
                attacker.send(body)                    # any bytes as the body of a message ...
                answer = attacker.answer()             # ... and the body of its response; b"" when it was closed
            attacker = server.logged_in("olga")        # or: a session, of a user or (None) anonymous
        harm.check()                                   # alive, no delay above 0.5 s, below 100 MB more, logins work

Delays are measured twice, on the clock and in seconds that the server computed while the victim waited, and the smaller
counts: so a busy machine alone cannot fail a test. The growth is that of the largest resident set (VmHWM).
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import resource
import socket
import struct
import threading
import time
from collections.abc import Generator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from tests.system import Processes, cli, free_multicast_url, free_tcp_port
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore

# asyncua declares UInt32 where it takes an int; attackers use it without types.
ua: Any = importlib.import_module("asyncua.ua")
binary: Any = importlib.import_module("asyncua.ua.ua_binary")

MOST_DELAY_S: Final = 0.5
MOST_GROWTH_MB: Final = 100.0
VICTIM: Final = "127.0.0.2"
"""The address that the victim, and the login after the attack, come from. Attackers come from 127.0.0.1."""
PASSWORDS: Final = {"olga": "observe-1", "oscar": "operate-1", "eva": "engineer-1"}
_ROLES: Final = {"olga": Role.OBSERVER, "oscar": Role.OPERATOR, "eva": Role.ENGINEER}
_NONE: Final = "http://opcfoundation.org/UA/SecurityPolicy#None"
_TICK_S: Final = 1 / os.sysconf("SC_CLK_TCK")
ROBOTS: Final[Mapping[str, Any]] = {
    "rover": {
        "bridge": "floor",
        "capacities": ["mobile"],
        "data": {
            "speed": {"id": 1001, "type": "Double", "unit": "m/s", "range": [-2, 2]},
            "goal": {"id": 1002, "type": "Double", "origin": "server", "range": [0, 1], "initial": 0},
            "name": {"id": 1003, "type": "String", "origin": "server"},
            "image": {"id": 1004, "type": "ByteString", "origin": "server"},
            "scan": {"id": 1005, "type": "Double", "array": True, "origin": "server"},
        },
        "skills": {"go": {"id": 1100, "needs": ["mobile"], "arguments": {"x": {"type": "Double", "default": 0}}}},
        "skill_status_id": 1101,
    }
}


class Attacker:
    """A TCP connection without security, blocking, whose owner sends whatever bytes they like."""

    def __init__(self, port: int, address: str = "127.0.0.1", timeout_s: float = 30) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=timeout_s, source_address=(address, 0))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.channel, self.sequence = 0, 0
        self.token: Any = ua.NodeId()
        """AuthenticationToken of the session."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.socket.close()

    def write(self, data: bytes) -> None:
        """Send bytes; what the server does not want any more is not this end's mistake."""
        with contextlib.suppress(ConnectionError):
            self.socket.sendall(data)

    def frame(self) -> bytes:
        """The next frame, empty when the server has closed."""
        head = self._read(8)
        return head + self._read(int.from_bytes(head[4:], "little") - 8) if head else b""

    def _read(self, size: int) -> bytes:
        data = bytearray()
        with contextlib.suppress(ConnectionError):
            while len(data) < size and (part := self.socket.recv(min(size - len(data), 1 << 20))):
                data += part
        return bytes(data) if len(data) == size else b""

    def hello(self) -> None:
        """Hello and Acknowledge."""
        self.write(binary.uatcp_to_binary(ua.MessageType.Hello, ua.Hello(0, 65_536, 65_536, 0, 0, "opc.tcp://x")))
        assert self.frame()[:3] == b"ACK"

    def open(self) -> None:
        """Hello, and a SecureChannel without security."""
        self.hello()
        request = ua.OpenSecureChannelRequest()
        request.Parameters.RequestedLifetime = 3_600_000
        request.Parameters.SecurityMode = ua.MessageSecurityMode.None_
        self.write(self.chunk(b"OPN", binary.struct_to_binary(request)))
        opened = self.frame()
        assert opened[:3] == b"OPN", opened
        self.channel = int.from_bytes(opened[8:12], "little")

    def chunk(self, kind: bytes, body: bytes, final: bytes = b"F", request_id: int = 1) -> bytes:
        """One chunk without security."""
        self.sequence += 1
        security = struct.pack("<i", len(_NONE)) + _NONE.encode() + b"\xff" * 8 if kind == b"OPN" else b"\x0d\0\0\0"
        rest = security + struct.pack("<II", self.sequence, request_id) + body
        return kind + final + struct.pack("<II", 12 + len(rest), self.channel) + rest

    def send(self, body: bytes) -> None:
        """Send a message of any length."""
        parts = [body[at : at + 65_000] for at in range(0, len(body), 65_000)] or [b""]
        for number, part in enumerate(parts):
            self.write(self.chunk(b"MSG", part, b"F" if number == len(parts) - 1 else b"C"))

    def answer(self) -> bytes:
        """Body of the next response, of all its chunks; empty when the server has closed or sent an Error."""
        body = b""
        while frame := self.frame():
            if frame[:3] != b"MSG":
                return b""
            body += frame[24:]
            if frame[3:4] == b"F":
                return body
        return b""

    def header(self) -> Any:
        """A RequestHeader of the session."""
        return ua.RequestHeader(AuthenticationToken=self.token, RequestHandle=1, TimeoutHint=0)

    def ask(self, request: Any) -> bytes:
        """Send a request of asyncua's classes as the session; the body of its response."""
        request.RequestHeader = self.header()
        self.send(binary.struct_to_binary(request))
        return self.answer()

    def call(self, request: Any, response: Any) -> Any:
        """As `ask`, decoded; a ServiceFault is returned as its StatusCode's name."""
        body = self.ask(request)
        if not body:
            return "closed"
        kind = binary.nodeid_from_binary(ua.utils.Buffer(body))
        if kind == ua.NodeId(ua.ObjectIds.ServiceFault_Encoding_DefaultBinary):
            fault = binary.struct_from_binary(ua.ServiceFault, ua.utils.Buffer(body))
            return str(fault.ResponseHeader.ServiceResult.name)
        return binary.struct_from_binary(response, ua.utils.Buffer(body))

    def create_session(self) -> Any:
        """CreateSession; its response or the name of a StatusCode."""
        request = ua.CreateSessionRequest()
        request.Parameters.ClientNonce = os.urandom(32)
        request.Parameters.RequestedSessionTimeout = 600_000
        request.Parameters.EndpointUrl = "opc.tcp://127.0.0.1"
        created = self.call(request, ua.CreateSessionResponse)
        if not isinstance(created, str):
            self.token = created.Parameters.AuthenticationToken
        return created

    def login(self, user: str | None = None) -> str:
        """CreateSession and ActivateSession, anonymous without a user; `Good`, `closed` or what it was refused with."""
        created = self.create_session()
        if isinstance(created, str):
            return created
        request = ua.ActivateSessionRequest()
        token: Any = ua.AnonymousIdentityToken(PolicyId="anonymous")
        if user is not None:
            token = ua.UserNameIdentityToken(PolicyId="username", UserName=user, Password=PASSWORDS[user].encode())
        request.Parameters.UserIdentityToken = token
        activated = self.call(request, ua.ActivateSessionResponse)
        return activated if isinstance(activated, str) else str(activated.ResponseHeader.ServiceResult.name)


class AttackedServer:
    """A running `ua-fleet serve`."""

    def __init__(self, folder: Path, port: int, process: Any) -> None:
        self.folder, self.port, self.process = folder, port, process

    @property
    def url(self) -> str:
        return f"opc.tcp://127.0.0.1:{self.port}/ua_fleet"

    @property
    def pid(self) -> int:
        return int(self.process.process.pid)

    @property
    def log(self) -> str:
        """What the server wrote, since its start."""
        return "\n".join(self.process.lines)

    def audit(self) -> list[dict[str, Any]]:
        """The lines of the audit log."""
        return [json.loads(line) for line in (self.folder / "state" / "audit.log").read_text().splitlines()]

    def alive(self) -> bool:
        return self.process.process.poll() is None

    def rss_mb(self) -> float:
        """Resident memory now."""
        return self._status("VmRSS")

    def peak_mb(self) -> float:
        """Largest resident memory since `forget_peak`, or since the start."""
        return self._status("VmHWM")

    def _status(self, name: str) -> float:
        lines = Path(f"/proc/{self.pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(f"{name}:"))

    def forget_peak(self) -> None:
        Path(f"/proc/{self.pid}/clear_refs").write_text("5")

    def computed_s(self) -> float:
        """CPU time of the server."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) * _TICK_S

    @contextlib.contextmanager
    def connected(self, address: str = "127.0.0.1") -> Generator[Attacker]:
        """A connection with an open channel, nobody logged in."""
        with Attacker(self.port, address) as attacker:
            attacker.open()
            yield attacker

    @contextlib.contextmanager
    def logged_in(self, user: str | None = None, address: str = "127.0.0.1") -> Generator[Attacker]:
        """A connection with an active session."""
        with self.connected(address) as attacker:
            assert attacker.login(user) == "Good"
            yield attacker

    @contextlib.contextmanager
    def harm(self, user: str | None = None) -> Generator[Harm]:
        """Watch what happens to a victim, and to the server, while the context lasts."""
        with Victim(self, user) as victim:
            self.forget_peak()
            harm = Harm(self, victim, self.rss_mb())
            yield harm
            harm.end()


class Victim:
    """A client of another address that reads the server's time every 0.1 s, in a thread."""

    def __init__(self, server: AttackedServer, user: str | None = None) -> None:
        self._server, self._user = server, user
        self._over = threading.Event()
        self._warm = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.reads = 0
        self.worst_delay_s = 0.0
        self.failure = ""

    def __enter__(self) -> Self:
        self._thread.start()
        assert self._warm.wait(20), self.failure
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """Stop after the read that is under way."""
        self._over.set()
        self._thread.join(60)

    def _run(self) -> None:
        try:
            with self._server.logged_in(self._user, VICTIM) as client:
                while not self._over.is_set():
                    self._read(client)
                    self._over.wait(0.1)
        except Exception as error:  # noqa: BLE001 - told by `Harm.check`
            self.failure = f"the victim lost its session: {error!r}"

    def _read(self, client: Attacker) -> None:
        request = ua.ReadRequest()
        request.Parameters.NodesToRead = [ua.ReadValueId(ua.NodeId(2258), ua.AttributeIds.Value)]
        began, computed = time.monotonic(), self._server.computed_s()
        read = client.call(request, ua.ReadResponse)
        delay = min(time.monotonic() - began, self._server.computed_s() - computed)
        if isinstance(read, str) or not read.Results[0].StatusCode.is_good():
            raise AssertionError(f"a read was answered with {read}")
        self.reads += 1
        self.worst_delay_s = max(self.worst_delay_s, delay)
        self._warm.set()


class Harm:
    """What an attack did."""

    def __init__(self, server: AttackedServer, victim: Victim, before_mb: float) -> None:
        self._server, self.victim, self._before_mb = server, victim, before_mb
        self.growth_mb = 0.0
        self.login = ""

    @property
    def delay_s(self) -> float:
        """Longest time that the victim waited for an answer."""
        return self.victim.worst_delay_s

    def end(self) -> None:
        """Measure what is left; done when the context ends."""
        self.victim.stop()
        if not self._server.alive():
            return
        self.growth_mb = self._server.peak_mb() - self._before_mb
        with contextlib.suppress(OSError), self._server.connected(VICTIM) as client:
            self.login = client.login()

    def check(self, *, delay_s: float = MOST_DELAY_S, growth_mb: float = MOST_GROWTH_MB) -> None:
        """Fail with all that is wrong; `pytest -rP` shows the figures."""
        print(f"delay {self.delay_s:.3f} s, growth {self.growth_mb:.0f} MB, {self.victim.reads} reads, {self.login}")
        wrong: list[str] = []
        if not self._server.alive():
            wrong.append("the server has ended")
        if self.victim.failure:
            wrong.append(self.victim.failure)
        if self.delay_s > delay_s:
            wrong.append(f"the victim waited {self.delay_s:.2f} s")
        if self.growth_mb > growth_mb:
            wrong.append(f"the server grew by {self.growth_mb:.0f} MB")
        if self.login != "Good":
            wrong.append(f"a login from another address got {self.login or 'no answer'}")
        if "Traceback" in self._server.log:
            wrong.append("the server logged a traceback")
        assert not wrong, "; ".join(wrong)


@contextlib.contextmanager
def attacked(
    folder: Path, *, robots: Mapping[str, Any] = ROBOTS, memory_mb: int | None = 3_000, **server: Any
) -> Generator[AttackedServer]:
    """A running server, open to anonymous clients without security unless `server` says otherwise.

    Args:
        folder: an empty one, for `fleet.yaml` and what the server keeps.
        robots: of `fleet.yaml`.
        memory_mb: address space that the server may take, so that no bomb takes the machine's; None for any.
        server: keys of `server` in `fleet.yaml`.
    """
    port = int(server.pop("port", 0)) or free_tcp_port()
    config: dict[str, Any] = {
        "version": 1,
        "server": {"port": port, "allow_none_security": True, "allow_anonymous": True, **server},
        "pubsub": {"security": "none", "url": free_multicast_url(), "interface": "127.0.0.1"},
        "monitoring": {"enabled": False},
        "bridges": {"floor": {"kind": "ros2", "space": 2, "status_id": 1900}},
        "robots": robots,
    }
    (folder / "fleet.yaml").write_text(json.dumps(config))
    users = UserStore(folder / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
    for name, password in PASSWORDS.items():
        users.add(name, password, _ROLES[name])
    with Processes() as processes:
        process = processes.start(*cli("serve", "-c", folder / "fleet.yaml"))
        if memory_mb is not None:
            limit = memory_mb * 1024 * 1024
            resource.prlimit(process.process.pid, resource.RLIMIT_AS, (limit, limit))
        process.wait_for("ready: ", 60)
        yield AttackedServer(folder, port, process)
