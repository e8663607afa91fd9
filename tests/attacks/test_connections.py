"""Floods of connections: a login from elsewhere gets through at each of its steps, however slow it is."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator

import pytest

from tests.attacks.harness import VICTIM, AttackedServer, Attacker, attacked, binary, ua


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AttackedServer]:
    with attacked(tmp_path_factory.mktemp("connections")) as running:
        yield running


class Flood:
    """Bare connections, all kept open from this side."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._open: list[socket.socket] = []

    def connect(self, count: int, address: str = "127.0.0.1", said: bytes = b"") -> None:
        for _ in range(count):
            with contextlib.suppress(ConnectionError):
                self._open.append(
                    socket.create_connection(("127.0.0.1", self._port), timeout=20, source_address=(address, 0))
                )
                self._open[-1].sendall(said)

    def close(self) -> None:
        for each in self._open:
            each.close()


@pytest.fixture
def flood(server: AttackedServer) -> Iterator[Flood]:
    flooding = Flood(server.port)
    yield flooding
    flooding.close()


def hello() -> bytes:
    return bytes(binary.uatcp_to_binary(ua.MessageType.Hello, ua.Hello(0, 65_536, 65_536, 0, 0, "opc.tcp://x")))


def slow_login(server: AttackedServer, address: str, between: Iterator[None]) -> str:
    """A login whose owner does something else between all its steps."""
    with Attacker(server.port, address) as client:
        next(between)
        client.open()
        next(between)
        created = client.create_session()
        if isinstance(created, str):
            return created
        next(between)
        request = ua.ActivateSessionRequest()
        request.Parameters.UserIdentityToken = ua.AnonymousIdentityToken(PolicyId="anonymous")
        activated = client.call(request, ua.ActivateSessionResponse)
        return activated if isinstance(activated, str) else str(activated.ResponseHeader.ServiceResult.name)


def test_five_hundred_connections_a_second(server: AttackedServer, flood: Flood) -> None:
    with server.harm() as harm:
        for _ in range(6):
            began = time.monotonic()
            flood.connect(250)
            with server.logged_in("olga", "127.0.0.3") as client:
                assert client.login("olga") == "Good"
            time.sleep(max(0.0, began + 0.5 - time.monotonic()))
    harm.check()


@pytest.mark.parametrize("said", ["nothing", "hello"])
def test_a_slow_login_from_another_address_gets_through(server: AttackedServer, flood: Flood, said: str) -> None:
    """The oldest connection does not make room for the greedy address's newest, as it did."""

    def floods() -> Iterator[None]:
        while True:
            flood.connect(150, said=hello() if said == "hello" else b"")
            yield

    assert slow_login(server, VICTIM, floods()) == "Good"


def test_who_has_progressed_stays_though_the_address_is_the_greedy_one(server: AttackedServer, flood: Flood) -> None:
    """Behind one address may be a gateway with many clients."""

    def floods() -> Iterator[None]:
        yield
        while True:
            flood.connect(150)
            yield

    assert slow_login(server, "127.0.0.1", floods()) == "Good"


def test_from_many_addresses_who_came_further_stays(server: AttackedServer, flood: Flood) -> None:
    def floods() -> Iterator[None]:
        yield
        while True:
            for number in range(150):
                flood.connect(1, f"127.0.7.{number + 1}")
            yield

    assert slow_login(server, VICTIM, floods()) == "Good"


def test_sessions_are_not_ended_by_connections(server: AttackedServer, flood: Flood) -> None:
    """An activated session never gives way, also not at the greediest address."""
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(server.logged_in("olga")) for _ in range(8)]
        flood.connect(400)
        read = ua.ReadRequest()
        read.Parameters.NodesToRead = [ua.ReadValueId(ua.NodeId(2259), ua.AttributeIds.Value)]
        for client in clients:
            assert client.call(read, ua.ReadResponse).Results[0].Value.Value == 0
