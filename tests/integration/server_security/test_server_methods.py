"""GetMonitoredItems and ResendData of the Server object, called by asyncua's client."""

from __future__ import annotations

from typing import Any

import pytest

from tests.integration.server_security.harness import Client, Door, bad, ua
from tests.integration.server_security.test_limits import create_subscription, monitored
from tests.integration.server_security.test_subscriptions import create_items, publish, values, watching

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def call(client: Client, method: Any, subscription: int) -> Any:
    server = client.get_node(ua.ObjectIds.Server)
    return await server.call_method(ua.NodeId(method), ua.Variant(subscription, ua.VariantType.UInt32))


async def test_items_of_a_subscription_are_listed(hardened: Door) -> None:
    async with hardened.connected("olga") as client:
        subscription = (await create_subscription(client)).SubscriptionId
        assert await call(client, ua.ObjectIds.Server_GetMonitoredItems, subscription) == [[], []]
        wanted = [monitored(hardened.nodes.plain, ClientHandle=handle) for handle in (71, 72)]
        made = await create_items(client, subscription, *wanted)
        listed = await call(client, ua.ObjectIds.Server_GetMonitoredItems, subscription)
        assert listed == [[item.MonitoredItemId for item in made], [71, 72]]


async def test_values_of_reporting_items_are_told_again(hardened: Door) -> None:
    async with hardened.connected("olga") as client:
        subscription = (await create_subscription(client)).SubscriptionId
        disabled = monitored(hardened.nodes.value)
        disabled.MonitoringMode = ua.MonitoringMode.Disabled
        sampling = monitored(hardened.nodes.value)
        sampling.MonitoringMode = ua.MonitoringMode.Sampling
        await create_items(client, subscription, disabled, sampling, monitored(hardened.nodes.plain))
        assert values(await publish(client)) == [7.0]
        for _ in range(2):
            await call(client, ua.ObjectIds.Server_ResendData, subscription)
            assert values(await publish(client)) == [7.0]


@pytest.mark.parametrize("method", ["Server_GetMonitoredItems", "Server_ResendData"])
async def test_only_the_owner_of_a_subscription_may_ask(hardened: Door, method: str) -> None:
    node = getattr(ua.ObjectIds, method)
    async with (
        hardened.connected() as owner,
        hardened.connected() as other,
        watching(owner, hardened.nodes.plain) as (subscription, _),
    ):
        assert await bad(call(other, node, subscription)) == "BadUserAccessDenied"
        assert await bad(call(owner, node, 999_999)) == "BadSubscriptionIdInvalid"


@pytest.mark.parametrize("name", ["Server_SetSubscriptionDurable", "Server_RequestServerStateChange"])
async def test_methods_that_are_not_implemented_are_not_there(hardened: Door, name: str) -> None:
    async with hardened.connected("eva") as client:
        for suffix in ("", "_InputArguments"):
            node = client.get_node(getattr(ua.ObjectIds, name + suffix))
            assert await bad(node.read_browse_name()) == "BadNodeIdUnknown"
        listed = {child.nodeid for child in await client.get_node(ua.ObjectIds.Server).get_children()}
        assert ua.NodeId(getattr(ua.ObjectIds, name)) not in listed
        assert ua.NodeId(ua.ObjectIds.Server_ResendData) in listed
