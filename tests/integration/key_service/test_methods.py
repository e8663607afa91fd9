"""The standard Methods and Nodes of a key service, as a foreign client meets them."""

from __future__ import annotations

from typing import Any

import pytest

from tests.integration.key_service.harness import (
    AES128,
    AES256,
    BASIC256SHA256,
    GET_GROUP,
    GROUPS,
    INVALIDATE,
    PUBLISH_SUBSCRIBE,
    ROTATE,
    Desk,
    call,
    get_keys,
    name,
    string,
    ua,
    uint32,
)
from tests.integration.server_security.test_audit_events import listen

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest.mark.parametrize("policy", [BASIC256SHA256, AES128, AES256])
async def test_a_bridge_gets_typed_keys_with_each_policy(running: Desk, policy: Any) -> None:
    async with running.connected(card="arm", policy=policy) as client:
        result = await get_keys(client, "t-2", 0, 3)
    assert name(result) == "Good"
    types = [variant.VariantType.name for variant in result.OutputArguments]
    assert types == ["String", "UInt32", "ByteString", "Double", "Double"]
    uri, token, keys, time_to_next_ms, lifetime_ms = (variant.Value for variant in result.OutputArguments)
    assert uri == "http://opcfoundation.org/UA/SecurityPolicy#PubSub-Aes256-CTR"
    assert [len(key) for key in keys] == [68, 68, 68]
    expected = running.service.keys_for_space(0, "t-2", 0, 3)
    assert (token, tuple(keys)) == (expected.first_token_id, expected.keys)
    assert 0 < time_to_next_ms <= lifetime_ms == 3_600_000.0


async def test_no_event_shows_keys(running: Desk) -> None:
    async with running.connected(card="visitor", user="eva") as engineer, running.connected(card="arm") as bridge:
        events = await listen(engineer)
        assert name(await get_keys(bridge, "t-2", 0, 1)) == "Good"
        called = await events.first("AuditUpdateMethodEventType")
    assert called.OutputArguments in (None, [])


async def test_groups_are_nodes(running: Desk) -> None:
    async with running.connected(card="plc") as client:
        children = await client.get_node(GROUPS).get_children()
        names = {(await child.read_browse_name()).Name for child in children}
        assert {"t-0", "t-1", "c-1", "t-2", "c-2", "t-300", "c-300"} <= names
        group = client.get_node(running.group("c-2"))
        assert (await group.read_type_definition()).Identifier == 15471
        members = {(await member.read_browse_name()).Name: member for member in await group.get_children()}
        values = {key: await members[key].read_value() for key in members if not key.endswith(("Keys", "Rotation"))}
        assert values == {
            "SecurityGroupId": "c-2",
            "KeyLifetime": 3_600_000.0,
            "SecurityPolicyUri": "http://opcfoundation.org/UA/SecurityPolicy#PubSub-Aes256-CTR",
            "MaxFutureKeyCount": 4,
            "MaxPastKeyCount": 1,
        }
        assert (await members["KeyLifetime"].read_data_type()).Identifier == 290
        assert {"InvalidateKeys", "ForceKeyRotation"} <= members.keys()
        assert await client.get_node("i=32843").read_value() is True


async def test_the_group_of_an_id(running: Desk) -> None:
    async with running.connected(card="arm") as bridge, running.connected(card="visitor", user="eva") as engineer:
        for client in (bridge, engineer):
            result = await call(client, PUBLISH_SUBSCRIBE, GET_GROUP, string("c-2"))
            assert name(result) == "Good"
            assert result.OutputArguments[0].VariantType == ua.VariantType.NodeId
            assert result.OutputArguments[0].Value.to_string() == running.group("c-2")
            assert name(await call(client, PUBLISH_SUBSCRIBE, GET_GROUP, string("c-9"))) == "BadNoMatch"
        assert name(await call(bridge, PUBLISH_SUBSCRIBE, GET_GROUP, string("c-300"))) == "BadUserAccessDenied"
        assert name(await call(engineer, PUBLISH_SUBSCRIBE, GET_GROUP, string("c-300"))) == "Good"


async def test_wrong_calls(running: Desk) -> None:
    async with running.connected(card="arm") as client:
        assert name(await get_keys(client, "t-9")) == "BadNotFound"
        assert name(await get_keys(client, "")) == "BadNotFound"
        null = ua.Variant(None, ua.VariantType.String)
        result = await call(client, PUBLISH_SUBSCRIBE, "i=15215", null, uint32(0), uint32(1))
        assert name(result) == "BadNotFound"
        result = await call(client, PUBLISH_SUBSCRIBE, "i=15215", string("t-0"), uint32(0))
        assert name(result) == "BadArgumentsMissing"
        result = await call(client, PUBLISH_SUBSCRIBE, "i=15215", string("t-0"), string("0"), uint32(1))
        assert name(result) == "BadInvalidArgument"


async def test_an_engineer_rotates_and_invalidates(running: Desk) -> None:
    async with running.connected(card="rover") as bridge, running.connected(card="visitor", user="eva") as engineer:
        before = (await get_keys(bridge, "t-300")).OutputArguments
        first, keys = before[1].Value, before[2].Value
        assert name(await call(engineer, running.group("t-300"), ROTATE)) == "Good"
        rotated = (await get_keys(bridge, "t-300")).OutputArguments
        assert (rotated[1].Value, rotated[2].Value[:4]) == (first + 1, keys[1:])
        assert name(await call(engineer, running.group("t-300"), INVALIDATE)) == "Good"
        fresh = (await get_keys(bridge, "t-300")).OutputArguments
        assert fresh[1].Value == first + 6
        assert not set(fresh[2].Value) & {*keys, *rotated[2].Value}
        # The type has these Methods too, and is no group.
        assert name(await call(engineer, "i=15471", INVALIDATE)) == "BadNodeIdInvalid"
        assert name(await call(engineer, "i=85", INVALIDATE)) == "BadMethodInvalid"


async def test_every_call_is_in_the_audit_log(running: Desk) -> None:
    async with running.connected(card="arm") as client:
        await get_keys(client, "c-2", 7, 3)
        await get_keys(client, "c-300")
    lines = [line for line in running.audit() if line.get("user") == "bridge:arm" and line["event"] == "call"]
    assert [(line["value"], line["status"], line["role"]) for line in lines[-2:]] == [
        ("['c-2', 7, 3]", "Good", "bridge"),
        ("['c-300', 0, 5]", "BadUserAccessDenied", "bridge"),
    ]
    assert lines[-1]["method"] == "i=15215"
