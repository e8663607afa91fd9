"""Session keys at the door: what they let in, what ends them, and what is written down."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from asyncua.client.client import Client as AsyncuaClient

from tests import system
from tests.integration.server_model.harness import ENGINEER, OBSERVER, OPERATOR, Running, fleet_config, serving
from tests.integration.server_security.harness import Client, Identities, bad, door, ua
from tests.integration.server_security.test_audit_events import listen
from tests.waiting import until
from ua_fleet.endpoint.call_limit import LEAST_BURST, LEAST_PER_SECOND
from ua_fleet.endpoint.key_text import new_key
from ua_fleet.endpoint.session_keys import KEYS_FILE, MOST_OF_USER, SessionKeys
from ua_fleet.endpoint.throttle import FREE_FAILURES
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.storage.files import write_whole

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def fleet(tmp_path_factory: pytest.TempPathFactory) -> AsyncGenerator[Running]:
    """A whole server with its three users."""
    config = fleet_config(system.free_multicast_url(), 0)
    async with serving(tmp_path_factory.mktemp("fleet"), config) as running:
        yield running


async def call(client: Client, name: str, *arguments: Any) -> list[Any]:
    """Call a Method of the fleet's Object with plain arguments."""
    fleet_object = client.get_node("ns=2;s=Fleet")
    returned: list[Any] = await fleet_object.call_method(ua.NodeId(f"Fleet.{name}", 2), *arguments)
    return returned


async def issue(running: Running, user: tuple[str, str] = OPERATOR, lifetime_s: float = 0.0) -> tuple[str, str]:
    """A key and its id."""
    async with running.client(user) as client:
        key, key_id, _until, status, message = await call(client, "IssueSessionKey", "a test", lifetime_s)
    assert (status, message) == (0, "")
    return key, key_id


def audit(running: Running) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (running.folder / "state" / "audit.log").read_text().splitlines()]


async def lost(client: Client) -> bool:
    """Whether the server has ended a client's session."""
    return await bad(client.get_node("i=2258").read_value()) in ("BadSessionIdInvalid", "BadSessionClosed", "closed")


async def test_a_key_is_a_password_of_its_user_for_any_client(fleet: Running) -> None:
    before = time.time()
    async with fleet.client(OPERATOR) as client:
        key, key_id, until_time, status, message = await call(client, "IssueSessionKey", "desk", 3600.0)
        assert (status, message) == (0, "")
        assert before + 3590 < until_time.timestamp() < time.time() + 3610
        ids, names, _issued, ends, _status, _message = await call(client, "ListSessionKeys")
        assert names[ids.index(key_id)] == "desk"
        assert ends[ids.index(key_id)] == until_time
    async with fleet.client((OPERATOR[0], key)) as client:
        assert await client.get_node("i=2258").read_value() is not None
        assert key_id in (await call(client, "ListSessionKeys"))[0]
    lines = audit(fleet)
    (issued,) = [line for line in lines if line["event"] == "session_key" and line["key"] == key_id]
    assert (issued["user"], issued["what"], issued["name"]) == ("oscar", "issued", "desk")
    (login,) = [line for line in lines if line.get("session_key") == key_id]
    assert (login["event"], login["user"], login["status"]) == ("login", "oscar", "Good")
    kept = (fleet.folder / "state" / "audit.log").read_text() + (fleet.folder / "state" / KEYS_FILE).read_text()
    assert key not in kept
    assert key.rpartition(".")[2] not in kept


async def test_a_key_is_not_another_users(fleet: Running) -> None:
    key, _ = await issue(fleet)
    with pytest.raises(ua.UaStatusCodeError, match="BadUserAccessDenied"):
        async with fleet.client((ENGINEER[0], key)):
            pass


async def test_a_key_issues_no_key(fleet: Running) -> None:
    key, _ = await issue(fleet)
    async with fleet.client((OPERATOR[0], key)) as client:
        made, key_id, _until, status, message = await call(client, "IssueSessionKey", "longer", 0.0)
    assert (made, key_id, status) == ("", "", 3)
    assert "open one with the password" in message


async def test_lifetimes_that_are_none_are_refused(fleet: Running) -> None:
    async with fleet.client(OPERATOR) as client:
        for lifetime_s in (-1.0, float("nan"), float("inf")):
            assert (await call(client, "IssueSessionKey", "x", lifetime_s))[3:] == [
                2,
                "Lifetime is no number of seconds",
            ]


async def test_revoking_ends_the_sessions_of_a_key_and_no_others(fleet: Running) -> None:
    """Each user revokes keys of his own alone, an observer too."""
    key, key_id = await issue(fleet, OBSERVER)
    async with fleet.client(ENGINEER) as engineer:
        assert (await call(engineer, "RevokeSessionKey", key_id))[0] == 1
    async with fleet.client((OBSERVER[0], key)) as by_key, fleet.client(OBSERVER) as by_password:
        assert (await call(by_password, "RevokeSessionKey", key_id)) == [0, ""]
        await until_ended(by_key)
        assert await by_password.get_node("i=2258").read_value() is not None
    with pytest.raises(ua.UaStatusCodeError, match="BadUserAccessDenied"):
        async with fleet.client((OBSERVER[0], key)):
            pass
    lines = [line for line in audit(fleet) if line.get("key") == key_id]
    assert [(line["what"], line["user"]) for line in lines] == [("issued", "olga"), ("revoked", "olga")]
    assert any(line["event"] == "logout" and key_id in line.get("reason", "") for line in audit(fleet))


async def test_who_revokes_his_own_key_gets_the_answer(fleet: Running, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the disk is slower than the server looks after sessions."""
    key, key_id = await issue(fleet)

    def slow(path: Path, data: bytes) -> None:
        time.sleep(0.8)
        write_whole(path, data)
        time.sleep(0.8)

    monkeypatch.setattr("ua_fleet.endpoint.session_keys.write_whole", slow)
    async with fleet.client((OPERATOR[0], key)) as client:
        assert await call(client, "RevokeSessionKey", key_id) == [0, ""]
        await until_ended(client)


async def test_a_key_ends_with_its_time_and_its_sessions_too(fleet: Running) -> None:
    key, _ = await issue(fleet, lifetime_s=1.0)
    async with fleet.client((OPERATOR[0], key)) as client:
        await until_ended(client)
    with pytest.raises(ua.UaStatusCodeError, match="BadUserAccessDenied"):
        async with fleet.client((OPERATOR[0], key)):
            pass


async def until_ended(client: Client) -> None:
    deadline = time.monotonic() + 10
    while not await lost(client):
        assert time.monotonic() < deadline


async def test_a_new_password_ends_the_keys(fleet: Running) -> None:
    key, _ = await issue(fleet, OBSERVER)
    users = UserStore(fleet.folder / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
    async with fleet.client((OBSERVER[0], key)) as client:
        users.add(*OBSERVER, Role.OBSERVER, replace_existing=True)
        await until_ended(client)


async def test_another_process_ends_keys_and_it_is_written_down(fleet: Running) -> None:
    key, key_id = await issue(fleet, ENGINEER)
    users = UserStore(fleet.folder / "state" / USERS_FILE)
    keys = SessionKeys(fleet.folder / "state" / KEYS_FILE, users, 1e9)
    async with fleet.client((ENGINEER[0], key)) as client:
        assert [one.id for one in keys.revoke_all(ENGINEER[0], time.time())] == [key_id]
        await until_ended(client)
    await until(lambda: any(line.get("what") == "revoked" and line["key"] == key_id for line in audit(fleet)), "line")


async def test_no_event_shows_a_key(fleet: Running) -> None:
    async with fleet.client(ENGINEER) as engineer:
        events = await listen(engineer)
        key, _ = await issue(fleet)
        called = await events.first("AuditUpdateMethodEventType")
        assert called.MethodId == ua.NodeId("Fleet.IssueSessionKey", 2)
        assert called.OutputArguments in (None, [])
        # A client may name the Method as the type of the Object has it.
        of_type = ua.NodeId(72033, 3)
        other, *_ = await engineer.get_node("ns=2;s=Fleet").call_method(of_type, "another", 0.0)
        called = await events.first("AuditUpdateMethodEventType", 2)
    assert (called.MethodId, called.OutputArguments) in ((of_type, None), (of_type, []))
    shown: list[dict[str, Any]] = [vars(event) for event in events.seen]
    assert not [one for one in (key, other) if one in str(shown)]


async def test_guessing_a_key_counts_like_guessing_a_password(tmp_path: Path, identities: Identities) -> None:
    async with door(tmp_path, identities) as guarded:
        keys = guarded.server.context.session_keys
        key = str(keys.issue("oscar", "desk", 0, time.time()).text)
        async with guarded.connected("oscar", password=key) as client:
            assert await client.get_node(guarded.nodes.plain).read_value() == 7.0
        for _ in range(FREE_FAILURES):
            guess = await guarded.client("oscar", password=str(new_key()))
            assert await bad(guess.connect()) == "BadUserAccessDenied"
        assert guarded.server.context.throttle.failed == FREE_FAILURES
        locked = await guarded.client("oscar", password=key)
        assert await bad(locked.connect()) == "BadUserAccessDenied"
        assert guarded.server.context.throttle.locked_out == 1


async def test_who_asks_in_a_loop_is_refused_and_fills_nothing(tmp_path: Path) -> None:
    """Each key is a write to the disk, and an observer may ask for one."""
    async with serving(tmp_path, fleet_config(system.free_multicast_url(), 0)) as running:
        async with running.client(OBSERVER) as client:
            began = time.monotonic()
            answers = [await bad(call(client, "IssueSessionKey", "x", 0.0)) for _ in range(200)]
            most = LEAST_BURST + LEAST_PER_SECOND * (time.monotonic() - began) + 1
            assert LEAST_BURST <= answers.count("Good") <= most
            assert set(answers) == {"Good", "BadServerTooBusy"}
            kept = (await call(client, "ListSessionKeys"))[0]
        assert len(kept) == MOST_OF_USER
        assert (running.folder / "state" / KEYS_FILE).stat().st_size < 16_000
        async with running.client(OPERATOR) as other:
            assert (await call(other, "IssueSessionKey", "x", 0.0))[3] == 0


async def test_a_server_without_keys_issues_none(tmp_path: Path) -> None:
    config = fleet_config(system.free_multicast_url(), 0, max_session_key_days=0)
    async with serving(tmp_path, config) as running, running.client() as client:
        *_, status, message = await call(client, "IssueSessionKey", "desk", 0.0)
        assert status == 3
        assert "max_session_key_days: 0" in message


async def test_nobody_without_a_password_has_keys(tmp_path: Path) -> None:
    """Clients without a user are observers, and bridges too; neither has a password that a key would stand for."""
    config = fleet_config(system.free_multicast_url(), 0, allow_anonymous=True, allow_none_security=True)
    async with serving(tmp_path, config) as running:
        anonymous: Client = AsyncuaClient(running.url)
        async with anonymous:
            for name in ("IssueSessionKey", "ListSessionKeys"):
                arguments = ("x", 0.0) if name == "IssueSessionKey" else ()
                assert await bad(call(anonymous, name, *arguments)) == "BadUserAccessDenied"
        # Where passwords may come in plain text, keys may go in plain text.
        plain: Client = AsyncuaClient(running.url)
        plain.set_user(OPERATOR[0])
        plain.set_password(OPERATOR[1])
        async with plain:
            assert (await call(plain, "IssueSessionKey", "desk", 0.0))[3] == 0
