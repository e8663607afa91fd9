"""Attacks through a gateway, and beside it: who knows a password gets in, and the server has its time for others."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, Self, TypeAlias

import pytest
from asyncua.client.client import Client as AsyncuaClient
from asyncua.crypto import security_policies

from tests.attacks.handshakes import client_certificate, encrypted_blocks, open_frame
from tests.attacks.harness import PASSWORDS, AttackedServer, attacked, binary, ua
from tests.integration.server_security.harness import bad, make_certificate, recorded
from tests.waiting import until
from ua_fleet.endpoint.certificates import CertificateFiles, trust_gateway
from ua_fleet.endpoint.users import USERS_FILE, Role, UserStore

Client: TypeAlias = Any
BASIC256SHA256: Any = security_policies.SecurityPolicyBasic256Sha256
URI = "urn:test:console"
PASSWORD = "as slow as real ones"
MOST_LOGIN_S = 10.0
"""For one login during an attack, from clients that have one core with the server; alone it takes 0.2 s."""
PEOPLE = ("olga", "oscar", "anna")


class Console:
    """A gateway in the place of the web console; its people and its attackers come from 127.0.0.1."""

    def __init__(self, server: AttackedServer, files: CertificateFiles) -> None:
        self._server, self._files = server, files
        self.logins: list[tuple[str, float]] = []
        """What each login of its people was answered with, and the seconds it took."""

    async def client(self, user: str, password: str) -> Client:
        client: Client = AsyncuaClient(self._server.url, timeout=60, watchdog_intervall=60)
        client.application_uri = URI
        client.set_user(user)
        client.set_password(password)
        own = self._server.folder / "state/certificates/own/server.der"
        await client.set_security(
            BASIC256SHA256, self._files.certificate, self._files.private_key, server_certificate=str(own)
        )
        return client

    async def log_in(self, user: str) -> None:
        """Log in and out as one who knows the password."""
        client = await self.client(user, PASSWORDS.get(user, PASSWORD))
        began = time.monotonic()
        answer = await bad(client.connect())
        self.logins.append((answer, time.monotonic() - began))
        if answer == "Good":
            await client.disconnect()

    async def guess(self, name: Callable[[int], str], seconds: float, at_a_time: int = 4) -> Counter[str]:
        """Try wrong passwords, ten over each connection; how often they were answered with what.

        160 each second at most: on a quick machine more would cost the gateway what it may cost at once, 700 or so.
        """
        answers: Counter[str] = Counter()
        over = time.monotonic() + seconds
        number = iter(range(1_000_000))

        async def work() -> None:
            while time.monotonic() < over:
                client = await self.client("nobody", "")
                with contextlib.suppress(ConnectionError, TimeoutError, ua.UaError):
                    await client.connect_sessionless()
                    await client.create_session()
                    for _ in range(10):
                        answers[await bad(client.activate_session(name(next(number)), "wrong guess"))] += 1
                client.disconnect_socket()
                await asyncio.sleep(10 * at_a_time / 160)

        await asyncio.gather(*(work() for _ in range(at_a_time)))
        return answers


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AttackedServer]:
    folder = tmp_path_factory.mktemp("gateways")
    with attacked(folder, trust_all_clients=True) as running:
        # With a real hash, which unknown users cost too.
        UserStore(folder / "state" / USERS_FILE).add("anna", PASSWORD, Role.OPERATOR)
        yield running


@pytest.fixture(scope="module")
def files(server: AttackedServer) -> CertificateFiles:
    made = make_certificate(server.folder, "console", uri=URI)
    trust_gateway(server.folder / "state", "console", made.certificate)
    return made


@pytest.fixture
def console(server: AttackedServer, files: CertificateFiles) -> Console:
    return Console(server, files)


def check(console: Console) -> None:
    """All who know their passwords have been let in, and soon."""
    print(f"{len(console.logins)} logins, the slowest in {max(taken for _, taken in console.logins):.2f} s")
    assert {answer for answer, _ in console.logins} == {"Good"}
    assert max(taken for _, taken in console.logins) < MOST_LOGIN_S
    assert len(console.logins) >= 3


@pytest.mark.parametrize("guessed", [["eva"], ["eva", "nobody{}"]], ids=["one", "invented too"])
async def test_guessers_in_browsers_keep_nobody_else_out(
    server: AttackedServer, console: Console, guessed: list[str]
) -> None:
    await console.log_in("anna")
    before = checked(server)
    with server.harm() as harm:
        computed, began = server.computed_s(), time.monotonic()
        guessing = asyncio.ensure_future(console.guess(lambda i: guessed[i % len(guessed)].format(i), 4))
        while not guessing.done():
            for user in PEOPLE:
                await console.log_in(user)
        answers = await guessing
        share = (server.computed_s() - computed) / (time.monotonic() - began)
    print(answers, f"{share:.2f} cores")
    harm.check()
    check(console)
    assert set(answers) <= {"BadUserAccessDenied", "BadServerTooBusy", "closed", "BadTcpServerTooBusy"}
    assert sum(answers.values()) > 30
    assert checked(server) - before < 30


def checked(server: AttackedServer) -> int:
    """Passwords that were looked at and wrong."""
    return (server.folder / "state/audit.log").read_text().count("wrong user or password")


class Flood:
    """A thread that does something as fast as it can, from the address of the console."""

    def __init__(self, act: Callable[[], None]) -> None:
        self._act, self._over = act, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.times = 0

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join(30)

    def _run(self) -> None:
        while not self._over.wait(0.002):
            with contextlib.suppress(OSError):
                self._act()
                self.times += 1


def hello() -> bytes:
    return bytes(binary.uatcp_to_binary(ua.MessageType.Hello, ua.Hello(0, 65_536, 65_536, 0, 0, "opc.tcp://x")))


async def test_strangers_beside_a_gateway_use_up_their_own_time(server: AttackedServer, console: Console) -> None:
    """From the console's address: handshakes with another certificate, then bytes of the console's own sent again."""
    own = (server.folder / "state/certificates/own/server.der").read_bytes()
    other = hello() + open_frame(own, encrypted_blocks(own, 12), client_certificate())
    recording = await console.client("anna", PASSWORD)
    await recording.connect_socket()
    replayed = recorded(recording)
    await recording.send_hello()
    await recording.open_secure_channel()
    recording.disconnect_socket()
    said = other

    def handshake() -> None:
        with socket.create_connection(("127.0.0.1", server.port), 5) as made:
            made.sendall(said)
            while (data := made.recv(4_096)) and b"OPN" not in data:
                pass

    with server.harm() as harm:
        async with await console.client("anna", PASSWORD) as staying:
            with Flood(handshake) as flood:
                await until(lambda: flood.times > 900)
                over = time.monotonic() + 4
                while time.monotonic() < over:
                    for user in PEOPLE:
                        await console.log_in(user)
                said = b"".join(replayed[:2])
                computed, began = server.computed_s(), time.monotonic()
                await asyncio.sleep(4)
                share = (server.computed_s() - computed) / (time.monotonic() - began)
                assert await staying.get_node("i=2258").read_value()
            print(f"{flood.times} handshakes, {share:.2f} cores for those sent again")
            check(console)
            await until_logged_in(console)
    harm.check()
    assert share < 0.8


async def until_logged_in(console: Console) -> None:
    """Log in once the reserve of the address is there again."""
    over = time.monotonic() + 30
    while True:
        await console.log_in("anna")
        if console.logins[-1][0] == "Good":
            return
        assert time.monotonic() < over, console.logins[-3:]
        await asyncio.sleep(0.5)
