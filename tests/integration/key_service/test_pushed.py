"""A foreign key service (asyncua as a client) pushes keys to the server, which gives them on to bridges."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from tests.integration.key_service.harness import (
    BASIC256SHA256,
    GET_GROUP,
    GROUPS,
    INVALIDATE,
    PASSWORDS,
    PUBLISH_SUBSCRIBE,
    Cards,
    Client,
    Desk,
    call,
    desk,
    get_keys,
    name,
    string,
    ua,
    uint32,
)
from tests.integration.key_service.test_traffic import Plant, more
from tests.integration.security.conftest import COUNTER_ONE, COUNTER_TWO, Site, heard, holes, secured
from tests.integration.server_security.harness import CHEAP
from tests.integration.server_security.test_audit_events import listen
from tests.unit.server.key_service.fleet import fleet
from tests.waiting import until
from ua_fleet.config.security import all_groups
from ua_fleet.endpoint.certificates import own_files
from ua_fleet.endpoint.users import USERS_FILE, Role, UserStore
from ua_fleet.server.key_service.pushed import KeysNotPushed
from ua_fleet.wire.security import SecurityPolicy

__all__ = ["secured"]

pytestmark = pytest.mark.asyncio(loop_scope="module")

SET_KEYS = "i=17364"
PUSHES = "i=32402"
"""SupportSecurityKeyPush of the PubSubCapabilities."""
POLICY = SecurityPolicy.AES256_CTR
SECRET = b"SECRET"
PUSHED = fleet(keys={"source": "pushed", "pushed_by": "olga"})


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def taking(tmp_path_factory: pytest.TempPathFactory, cards: Cards) -> AsyncGenerator[Desk]:
    """A server that olga, who is an observer, may push keys to."""
    async with desk(tmp_path_factory.mktemp("desk"), cards, config=PUSHED) as made:
        yield made


def key(token: int) -> bytes:
    return SECRET + token.to_bytes(POLICY.key_data_bytes - len(SECRET), "big")


def arguments(group: str = "t-2", first: int = 5, **changes: Any) -> list[Any]:
    """Those of SetSecurityKeys, as the specification has them (OPC 10000-14 9.1.3.3)."""
    given = {
        "group": string(group),
        "policy": string(POLICY.value),
        "token": uint32(first),
        "current": ua.Variant(key(first), ua.VariantType.ByteString),
        "future": ua.Variant([key(first + 1), key(first + 2)], ua.VariantType.ByteString),
        "next": ua.Variant(40_000.0, ua.VariantType.Double),
        "lifetime": ua.Variant(100_000.0, ua.VariantType.Double),
    }
    return list((given | changes).values())


async def push(client: Client, *given: Any, **changes: Any) -> Any:
    return await call(client, PUBLISH_SUBSCRIBE, SET_KEYS, *arguments(*given, **changes))


async def test_a_bridge_gets_what_was_pushed(taking: Desk) -> None:
    async with (
        taking.connected(card="visitor", user="olga") as service,
        taking.connected(card="rover") as bridge,
    ):
        assert name(await get_keys(bridge, "t-2")) == "BadNotFound"
        changes = bridge.get_node("ns=2;s=SecurityGroups.Changes")
        before = await changes.read_value()
        pushed = await push(service)
        assert (name(pushed), pushed.OutputArguments or []) == ("Good", [])
        assert await changes.read_value() == before + 1
        answer = await get_keys(bridge, "t-2")
        uri, token, keys, next_ms, lifetime_ms = (variant.Value for variant in answer.OutputArguments)
        assert (uri, token, keys, lifetime_ms) == (POLICY.value, 5, [key(5), key(6), key(7)], 100_000.0)
        assert 0 < next_ms <= 40_000.0
        null_future = ua.Variant(None, ua.VariantType.ByteString, is_array=True)
        assert name(await push(service, "t-300", 1, future=null_future)) == "Good"
        assert (await get_keys(bridge, "t-300")).OutputArguments[2].Value == [key(1)]


async def test_only_its_user_may_push(taking: Desk) -> None:
    async with taking.connected(card="visitor", user="eva") as engineer:
        assert name(await push(engineer)) == "BadUserAccessDenied"
    async with taking.connected(card="arm") as bridge:
        assert name(await push(bridge)) == "BadUserAccessDenied"


async def test_keys_are_taken_encrypted_only(tmp_path: Path, cards: Cards) -> None:
    async with desk(
        tmp_path,
        cards,
        config=PUSHED,
        policies=[ua.SecurityPolicyType.Basic256Sha256_Sign, ua.SecurityPolicyType.NoSecurity],
        allow_none_security=True,
    ) as made:
        async with made.connected(card="visitor", user="olga", mode=ua.MessageSecurityMode.Sign) as client:
            assert name(await push(client)) == "BadSecurityModeInsufficient"
        async with made.connected(card="visitor", user="olga", policy=None) as client:
            assert name(await push(client)) == "BadSecurityModeInsufficient"
        with pytest.raises(KeysNotPushed):
            made.service.keys_for_space(0, "t-2", 0, 1)


async def test_what_is_wrong_is_refused_by_its_code(taking: Desk) -> None:
    long = ua.Variant([key(6), bytes(69)], ua.VariantType.ByteString)
    expected = {
        "BadNotFound": [{"group": string("t-9")}, {"group": string("")}],
        "BadSecurityPolicyRejected": [{"policy": string(SecurityPolicy.AES128_CTR.value)}, {"policy": string("")}],
        "BadInvalidArgument": [
            {"token": uint32(0)},
            {"token": string("5")},
            {"current": ua.Variant(b"short", ua.VariantType.ByteString)},
            {"current": ua.Variant(None, ua.VariantType.ByteString)},
            {"future": long},
            {"future": ua.Variant([key(5)], ua.VariantType.ByteString)},
            {"next": ua.Variant(-1.0, ua.VariantType.Double)},
            {"next": ua.Variant(100_001.0, ua.VariantType.Double)},
            {"lifetime": ua.Variant(float("nan"), ua.VariantType.Double)},
            {"lifetime": ua.Variant(0.0, ua.VariantType.Double)},
        ],
    }
    async with taking.connected(card="visitor", user="olga") as service:
        assert name(await push(service)) == "Good"
        for status, cases in expected.items():
            for changes in cases:
                assert name(await push(service, **changes)) == status, changes
        few = await call(service, PUBLISH_SUBSCRIBE, SET_KEYS, *arguments()[:6])
        assert name(few) == "BadArgumentsMissing"
    async with taking.connected(card="rover") as bridge:
        assert (await get_keys(bridge, "t-2")).OutputArguments[1].Value == 5


async def test_neither_log_nor_event_shows_what_was_pushed(taking: Desk) -> None:
    async with (
        taking.connected(card="visitor", user="eva") as engineer,
        taking.connected(card="visitor", user="olga") as service,
    ):
        events = await listen(engineer)
        assert name(await push(service)) == "Good"
        called = await events.first("AuditUpdateMethodEventType")
        assert called.InputArguments in (None, [])
        await push(service, current=string("SECRET as a text"))
    assert any(line.get("method") == SET_KEYS and line["user"] == "olga" for line in taking.audit())
    assert "SECRET" not in taking.audit_text()


async def test_the_nodes_say_what_the_server_takes(taking: Desk, running: Desk) -> None:
    async with taking.connected(card="visitor", user="olga") as client:
        assert await client.get_node(PUSHES).read_value() is True
        children = await client.get_node(GROUPS).get_children()
        names = {(await child.read_browse_name()).Name for child in children}
        assert "Changes" in names
        assert not any(each.startswith(("t-", "c-")) for each in names)
    async with taking.connected(card="visitor", user="eva") as engineer:
        assert name(await call(engineer, PUBLISH_SUBSCRIBE, GET_GROUP, string("t-2"))) == "BadNoMatch"
        assert name(await call(engineer, taking.group("t-2"), INVALIDATE)) == "BadNodeIdUnknown"
    # A server that makes its keys takes none, and shows none that somebody pushes there by mistake.
    async with running.connected(card="visitor", user="olga") as client:
        assert name(await push(client)) in ("BadMethodInvalid", "BadNodeIdUnknown")
    assert "SECRET" not in running.audit_text()


@pytest.fixture
def plant(secured: Site) -> Plant:
    secured.write_fleet(keys={"source": "pushed", "pushed_by": "sks", "future_keys": 8})
    return Plant(secured)


@pytest.mark.asyncio(loop_scope="function")
async def test_bridges_speak_with_keys_that_were_pushed(plant: Plant, tmp_path: Path) -> None:
    state_dir = plant.site.folder / plant.site.config.server.state_dir
    UserStore(state_dir / USERS_FILE, CHEAP).add("sks", PASSWORDS["olga"], Role.OBSERVER)
    await plant.introduce()
    cards = Cards(tmp_path / "cards")
    cards.folder.mkdir()

    async def push_all(first: int) -> None:
        async with await _client(plant, cards, state_dir) as client:
            for group in all_groups(plant.site.config):
                keys = [group.encode().ljust(64, b".") + (first + each).to_bytes(4, "big") for each in range(3)]
                given = arguments(
                    group,
                    first,
                    current=ua.Variant(keys[0], ua.VariantType.ByteString),
                    future=ua.Variant(keys[1:], ua.VariantType.ByteString),
                )
                assert name(await call(client, PUBLISH_SUBSCRIBE, SET_KEYS, *given)) == "Good"

    async with plant.server():
        one, two = plant.site.bridge("one", wait=False), plant.site.bridge("two", wait=False)
        await push_all(1)
        await until(lambda: "ready" in one.lines and "ready" in two.lines)
        await more(two, COUNTER_ONE)
        await more(one, COUNTER_TWO)
        await push_all(2)  # the second key counts before its time, and nothing is lost
        await more(two, COUNTER_ONE, 100)
        assert holes(heard(two, COUNTER_ONE)) == []
        await push_all(100)  # begun anew
        await more(two, COUNTER_ONE)
    async with plant.server():  # a server that restarts has what was pushed
        three = len(heard(one, COUNTER_TWO))
        await until(lambda: len(heard(one, COUNTER_TWO)) > three)


async def _client(plant: Plant, cards: Cards, state_dir: Path) -> Client:
    from asyncua.client.client import Client as AsyncuaClient

    client: Client = AsyncuaClient(plant.url, timeout=60)
    client.application_uri = cards.uri("sks")
    files = cards.get("sks")
    await client.set_security(
        BASIC256SHA256,
        files.certificate,
        files.private_key,
        server_certificate=str(own_files(state_dir).certificate),
        mode=ua.MessageSecurityMode.SignAndEncrypt,
    )
    client.set_user("sks")
    client.set_password(PASSWORDS["olga"])
    return client
