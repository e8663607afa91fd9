"""Gateways: people behind one client and one address, of whom one who guesses locks nobody else out."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncGenerator
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from tests.integration.server_security.harness import (
    CHEAP,
    CLIENT_URI,
    PASSWORDS,
    SERVER_URI,
    Client,
    Door,
    Identities,
    Raw,
    bad,
    door,
    recorded,
)
from tests.waiting import until
from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.config.schema import ServerConfig
from ua_fleet.endpoint import throttle
from ua_fleet.endpoint.certificates import revoke_gateway, trust, trust_gateway
from ua_fleet.endpoint.charges import GATEWAY_AT_ONCE_S, REFUSED_LOGIN_S
from ua_fleet.endpoint.gateway_logins import UNKNOWN_AT_ONCE, Attempt, LoginOutcome
from ua_fleet.endpoint.hardened_server import create_server
from ua_fleet.endpoint.key_text import new_key
from ua_fleet.endpoint.strangers import AT_ONCE_S, StrangersTime
from ua_fleet.endpoint.throttle import FREE_FAILURES, FREE_FAILURES_OF_ADDRESS
from ua_fleet.endpoint.users import UserStore
from ua_fleet.errors import AccessRefused, NotConnected

pytestmark = pytest.mark.asyncio(loop_scope="module")

CONSOLE_URI = "urn:test:console"
HERE = "127.0.0.1"
GUESSES = 400
TRIES_OF_CONNECTION = 25
REFUSED = {"closed", "BadTcpServerTooBusy"}


class Console:
    """A client through which many people come, each with a connection and a session."""

    def __init__(self, guarded: Door) -> None:
        self.door = guarded
        self.files = guarded.identities.get("console", uri=CONSOLE_URI)

    def mark(self) -> None:
        trust_gateway(self.door.state_dir, "console", self.files.certificate)

    async def client(self, user: str, password: str | None = None) -> Client:
        return await self.door.client(user, self.files, uri=CONSOLE_URI, password=password)

    @contextlib.asynccontextmanager
    async def connected(self, user: str, password: str | None = None) -> AsyncGenerator[Client]:
        async with await self.client(user, password) as client:
            yield client

    async def login(self, user: str, password: str | None = None) -> str:
        """Log in and out; what the login was answered with."""
        client = await self.client(user, password)
        answer = await bad(client.connect())
        if answer == "Good":
            await client.disconnect()
        return answer

    async def guess(self, users: list[str], at_a_time: int = 4) -> list[str]:
        """Log in with wrong passwords, over a few connections; what they were answered with."""
        answers: list[str] = []
        left = list(users)
        tries = min(TRIES_OF_CONNECTION, len(users) // at_a_time)

        async def work() -> None:
            while left:
                client = await self.client("nobody")
                await client.connect_sessionless()
                await client.create_session()
                now = [left.pop() for _ in range(min(len(left), tries))]
                answers.extend([await bad(client.activate_session(user, "wrong guess")) for user in now])
                await client.disconnect_sessionless()

        await asyncio.gather(*(work() for _ in range(at_a_time)))
        return answers

    @property
    def outcomes(self) -> dict[str, int]:
        counted = self.door.server.context.gateway_logins.outcomes
        return {outcome.value: counted["console", outcome] for outcome in LoginOutcome}


@pytest_asyncio.fixture(loop_scope="module")
async def console(tmp_path: Path, identities: Identities) -> AsyncGenerator[Console]:
    """A server that has marked a client while it ran."""
    async with door(tmp_path, identities) as guarded:
        made = Console(guarded)
        made.mark()
        yield made


async def reads(client: Client, guarded: Door) -> bool:
    return bool(await client.get_node(guarded.nodes.plain).read_value() == 7.0)


async def test_a_guesser_locks_out_the_name_and_nobody_else(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(throttle, "FIRST_LOCK_S", throttle.LONGEST_LOCK_S)  # until the test has ended
    guarded = console.door
    key = str(guarded.server.context.session_keys.issue("oscar", "console", 0, time.time()).text)
    async with console.connected("oscar") as before:
        guessing = asyncio.ensure_future(console.guess(["oscar"] * GUESSES))
        await until(lambda: console.outcomes["locked_out"] > FREE_FAILURES)
        logins = 0
        while not guessing.done() or not logins:
            assert await console.login("olga") == "Good"
            assert await console.login("oscar", key) == "Good"
            assert await reads(before, guarded)
            logins += 1
        assert set(await guessing) <= {"BadUserAccessDenied", "BadServerTooBusy"}
        assert await console.login("oscar") == "BadUserAccessDenied", "the name is locked out through this gateway"
        async with guarded.connected("oscar") as direct:
            assert await reads(direct, guarded), "and nowhere else"
    assert console.outcomes["wrong_password"] < 20, "few were looked at"
    assert console.outcomes["locked_out"] > GUESSES * 0.9
    assert sum(console.outcomes.values()) - console.outcomes["accepted"] == GUESSES + 1
    assert guarded.server.context.throttle.failed == 0


async def test_names_that_nobody_has_keep_no_user_out(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    guarded = console.door
    checked: list[str] = []
    verify = guarded.users.verify

    def slow_verify(name: str, password: str) -> Any:
        checked.append(name)
        time.sleep(0.05)
        return verify(name, password)

    monkeypatch.setattr(guarded.users, "verify", slow_verify)
    began = time.monotonic()
    guessing = asyncio.ensure_future(console.guess([f"nobody{number}" for number in range(GUESSES)], 8))
    await until(lambda: console.outcomes["too_busy"])
    logins = 0
    while not guessing.done():
        for user in ("olga", "oscar", "eva"):
            assert await console.login(user) == "Good"
            logins += 1
    assert logins >= 3
    assert (await guessing).count("BadServerTooBusy") > GUESSES / 2
    made_up = [name for name in checked if name.startswith("nobody")]
    assert len(made_up) <= UNKNOWN_AT_ONCE + time.monotonic() - began + 1


async def test_the_answer_does_not_tell_which_names_there_are(console: Console) -> None:
    logins = console.door.server.context.gateway_logins
    for is_flooded, answer in ((False, "BadUserAccessDenied"), (True, "BadServerTooBusy")):
        if is_flooded:
            while logins.may_check(Attempt("console", "drained", is_known=False), time.monotonic()):
                pass
        assert await console.login("nobody", "wrong guess") == answer
        assert await console.login("oliver", "wrong guess") == answer
    assert await console.login("oliver") == "Good"


async def test_many_tries_for_one_name_take_few_places(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    guarded = console.door
    verify = guarded.users.verify

    def slow_verify(name: str, password: str) -> Any:
        time.sleep(0.3)
        return verify(name, password)

    monkeypatch.setattr(guarded.users, "verify", slow_verify)
    guessing = asyncio.ensure_future(console.guess(["oscar"] * 12, 12))
    await until(lambda: console.outcomes["too_busy"])
    assert await console.login("olga") == "Good"
    assert set(await guessing) == {"BadServerTooBusy", "BadUserAccessDenied"}


async def test_a_wrong_session_key_locks_nothing(console: Console) -> None:
    keys = console.door.server.context.session_keys
    key = str(keys.issue("oscar", "console", 0, time.time()).text)
    for _ in range(FREE_FAILURES * 3):
        assert await console.login("oscar", str(new_key())) == "BadUserAccessDenied"
    assert await console.login("oscar", key) == "Good"
    assert await console.login("oscar") == "Good"
    assert console.outcomes == {
        "accepted": 2, "wrong_key": FREE_FAILURES * 3, "wrong_password": 0, "locked_out": 0, "too_busy": 0
    }  # fmt: skip
    assert await console.login("oliver", key) == "BadUserAccessDenied", "another user's"


async def test_without_the_mark_nothing_changes(tmp_path: Path, identities: Identities) -> None:
    async with door(tmp_path, identities) as guarded:
        plain = Console(guarded)
        trust(guarded.state_dir, plain.files.certificate)
        key = str(guarded.server.context.session_keys.issue("olga", "console", 0, time.time()).text)
        names = [f"nobody{number}" for number in range(FREE_FAILURES_OF_ADDRESS)]
        assert set(await plain.guess(names, 1)) == {"BadUserAccessDenied"}
        for user, password in (("olga", None), ("olga", key)):
            assert await plain.login(user, password) == "BadUserAccessDenied", "the address is locked out"
        assert not guarded.server.context.gateway_logins.outcomes
        charges = guarded.server.context.charges
        assert not charges.has_gateway(HERE)
        charges.strangers.spend(HERE, 2 * AT_ONCE_S, time.monotonic())
        assert await plain.login("olga") in REFUSED


async def test_a_mark_gives_no_rights(console: Console) -> None:
    guarded = console.door
    async with console.connected("olga") as client:
        value = client.get_node(guarded.nodes.value)
        assert await bad(value.write_value(2.5)) == "BadUserAccessDenied"
    certificate_alone = await console.client("olga")
    certificate_alone._username = certificate_alone._password = None
    assert await bad(certificate_alone.connect()) in ("BadIdentityTokenRejected", "BadIdentityTokenInvalid")


async def test_the_mark_is_followed_at_once(console: Console) -> None:
    guarded, charges = console.door, console.door.server.context.charges
    async with console.connected("olga") as client:
        assert charges.has_gateway(HERE)
        trust(guarded.state_dir, console.files.certificate)
        await until(lambda: not charges.has_gateway(HERE))
        assert await reads(client, guarded), "an ordinary client goes on"
        assert await console.login("oscar", "wrong guess") == "BadUserAccessDenied"
        assert guarded.server.context.throttle.failed == 1
        console.mark()
        await until(lambda: charges.has_gateway(HERE))
        assert await console.login("oscar", "wrong guess") == "BadUserAccessDenied"
        assert guarded.server.context.throttle.failed == 1


async def test_the_sessions_through_a_gateway_end_with_its_trust(console: Console) -> None:
    guarded = console.door
    async with console.connected("olga") as client, guarded.connected("oscar") as other:
        revoke_gateway(guarded.state_dir, "console")
        await until(lambda: any(line.get("reason") == "gateway revoked" for line in guarded.audit()))
        assert await bad(client.get_node("i=2258").read_value()) in ("BadSessionIdInvalid", "closed")
        assert await reads(other, guarded)
        assert await console.login("olga") in ("BadSecurityChecksFailed", "closed")
    assert {line["user"] for line in guarded.audit() if line.get("reason") == "gateway revoked"} == {"olga"}


async def test_the_mark_lasts_over_a_restart(tmp_path: Path, identities: Identities) -> None:
    async with door(tmp_path, identities) as first:
        console = Console(first)
        console.mark()
    users = UserStore(first.state_dir / "users.yaml", CHEAP)
    server = await create_server(ServerConfig(port=0), first.state_dir, application_uri=SERVER_URI, users=users)
    async with server:
        console.door = Door(server, first.state_dir, users, first.nodes, identities)
        names = ["oscar"] * FREE_FAILURES_OF_ADDRESS
        assert set(await console.guess(names, 1)) == {"BadUserAccessDenied"}
        assert await console.login("olga") == "Good"
        assert console.outcomes["locked_out"] > 0


async def test_the_audit_log_names_the_gateway(console: Console) -> None:
    assert await console.login("olga") == "Good"
    assert await console.login("oscar", "wrong guess") == "BadUserAccessDenied"
    lines = console.door.audit()
    (login,) = [line for line in lines if line["event"] == "login"]
    assert (login["user"], login["gateway"], login["application"]) == ("olga", "console", CONSOLE_URI)
    (refusal,) = [line for line in lines if line["event"] == "refusal"]
    assert refusal["reason"] == "login of 'oscar' through gateway console: wrong user or password"
    async with console.door.connected("eva"):
        pass
    assert "gateway" not in next(line for line in reversed(console.door.audit()) if line["event"] == "login")


# --- computing time


async def test_an_address_that_has_cost_too_much_still_has_its_gateway(console: Console) -> None:
    guarded, context = console.door, console.door.server.context
    async with console.connected("olga"), guarded.connected("oscar") as ordinary:
        context.charges.strangers.spend(HERE, 100 * AT_ONCE_S, time.monotonic())
        refused = context.statistics.strangers_refused
        assert await bad((await guarded.client("eva")).connect()) in REFUSED
        assert context.statistics.strangers_refused == refused + 1
        assert await console.login("eva") == "Good"
        assert await reads(ordinary, guarded)
    await until(lambda: not context.charges.has_gateway(HERE))
    assert await console.login("eva") in REFUSED, "no gateway is connected from there"


async def test_a_gateway_that_asks_for_endpoints_first_is_let_in_too(console: Console, tmp_path: Path) -> None:
    """As our own client does, and most others."""
    guarded, context = console.door, console.door.server.context
    board, other = (ClientIdentity(tmp_path / name, application_uri=f"urn:test:{name}") for name in ("board", "other"))
    for identity in (board, other):
        await identity.ensure()
    trust_gateway(guarded.state_dir, "board", board.certificate)
    trust(guarded.state_dir, other.certificate)

    def connect(user: str, identity: ClientIdentity) -> AbstractAsyncContextManager[FleetClient]:
        return FleetClient.connect(guarded.url, user=user, password=PASSWORDS[user], identity=identity)

    async with connect("olga", board):
        context.charges.strangers.spend(HERE, 100 * AT_ONCE_S, time.monotonic())
        for user in ("oscar", "eva"):
            async with connect(user, board) as client:
                assert await client.read(guarded.nodes.plain.to_string())
        with pytest.raises((NotConnected, AccessRefused)):
            async with connect("oscar", other):
                pass


async def test_failed_logins_are_owed_by_the_gateway_and_not_by_its_address(console: Console) -> None:
    charges = console.door.server.context.charges
    charges.gateways, charges.strangers = StrangersTime(GATEWAY_AT_ONCE_S, 0.0), StrangersTime(share=0.0)
    await console.guess(["oscar"] * GUESSES)
    owed = charges.gateways.owed("console", time.monotonic())
    assert GUESSES * REFUSED_LOGIN_S < owed < GATEWAY_AT_ONCE_S
    assert charges.strangers.owed(HERE, time.monotonic()) < owed / 100
    charges.gateways.spend("console", 2 * GATEWAY_AT_ONCE_S, time.monotonic())
    assert await console.login("olga") in REFUSED, "it has a bound of its own"
    async with console.door.connected("olga") as direct:
        assert await reads(direct, console.door)


async def test_who_sends_a_gateways_bytes_again_is_no_gateway(console: Console) -> None:
    guarded, charges = console.door, console.door.server.context.charges
    client = await console.client("olga")
    await client.connect_socket()
    sent = recorded(client)
    await client.send_hello()
    await client.open_secure_channel()
    assert not charges.has_gateway(HERE), "nor is the gateway itself before it has said something"
    await client.create_session()
    assert charges.has_gateway(HERE)
    client.disconnect_socket()
    await until(lambda: not charges.has_gateway(HERE))
    async with Raw.open(guarded.server.port) as replay:
        for data in sent:
            replay.write(data)
            if data[:3] == b"OPN":
                break
        assert (await replay.answer())[:3] == b"ACK"
        assert (await replay.answer())[:3] == b"OPN"
        replay.write(sent[-1])
        assert await replay.closed()
        assert not charges.has_gateway(HERE)


# --- places


async def test_logins_through_a_gateway_and_others_take_no_places_from_each_other(
    tmp_path: Path, identities: Identities
) -> None:
    async with (
        door(tmp_path, identities, limits={"connections": 20, "handshake_s": 60.0}) as guarded,
        contextlib.AsyncExitStack() as stack,
    ):
        console = Console(guarded)
        console.mark()

        async def begun(client: Client) -> Client:
            await client.connect_sessionless()
            await client.create_session()
            stack.callback(client.disconnect_socket)
            return client

        people = [await begun(await console.client("olga")) for _ in range(5)]
        others = [await begun(await guarded.client("oscar")) for _ in range(8)]
        evicted = guarded.server.statistics.connections_evicted
        assert evicted == len(others) - 5 - 1, "of the ordinary ones, at the next that comes"
        assert [await bad(client.activate_session("olga", PASSWORDS["olga"])) for client in people] == ["Good"] * 5
        assert await console.login("eva") == "Good"
        assert CLIENT_URI not in {line.get("application") for line in guarded.audit()}
