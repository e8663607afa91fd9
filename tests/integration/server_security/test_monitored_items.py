"""Sampling, monitoring modes, triggering and deadbands as OPC 10000-4 5.13 has them, asked through asyncua's client."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from enum import IntEnum
from typing import Any

import pytest
import pytest_asyncio

from tests.integration.server_security.harness import Client, Door, bad, send, ua
from tests.integration.server_security.test_limits import create_subscription, monitored
from tests.integration.server_security.test_subscriptions import create_items, publish
from ua_fleet.endpoint.monitored_items import MonitoredItems

pytestmark = pytest.mark.asyncio(loop_scope="module")

REPORTING, SAMPLING, DISABLED = ua.MonitoringMode.Reporting, ua.MonitoringMode.Sampling, ua.MonitoringMode.Disabled


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def three(hardened: Door) -> AsyncGenerator[list[Any]]:
    """Three variables of the server; the first one has an EURange."""
    server = hardened.server
    made = [await server.nodes.objects.add_variable(ua.NodeId(f"v{n}", 2), f"v{n}", 0.0) for n in range(3)]
    await made[0].add_property(2, "not it", ua.Range(0.0, 1.0))
    await made[0].add_property(ua.NodeId("v0range", 2), ua.QualifiedName("EURange", 0), ua.Range(-100.0, 100.0))
    yield made


def watch(node: Any, handle: int, mode: Any = REPORTING, **parameters: Any) -> Any:
    item = monitored(node.nodeid, ClientHandle=handle, **{"QueueSize": 10, **parameters})
    item.MonitoringMode = mode
    return item


async def told(client: Client) -> list[tuple[int, Any]]:
    """Handles and values of the next message with values; [] for a keep-alive."""
    data = (await publish(client)).NotificationMessage.NotificationData
    return [(item.ClientHandle, item.Value.Value.Value) for each in data for item in each.MonitoredItems]


async def set_mode(client: Client, subscription: int, mode: Any, *items: Any) -> list[str]:
    request = ua.SetMonitoringModeRequest()
    request.Parameters.SubscriptionId = subscription
    request.Parameters.MonitoringMode = mode
    request.Parameters.MonitoredItemIds = [item.MonitoredItemId for item in items]
    results = (await send(client, request, ua.SetMonitoringModeResponse)).Parameters.Results
    return [result.name for result in results]


async def trigger(client: Client, subscription: int, item: int, add: list[int], remove: list[int]) -> Any:
    request = ua.SetTriggeringRequest()
    request.Parameters.SubscriptionId, request.Parameters.TriggeringItemId = subscription, item
    request.Parameters.LinksToAdd, request.Parameters.LinksToRemove = add, remove
    result = (await send(client, request, ua.SetTriggeringResponse)).Parameters
    return [code.name for code in result.AddResults], [code.name for code in result.RemoveResults]


async def modify(client: Client, subscription: int, item: Any, **parameters: Any) -> Any:
    request = ua.ModifyMonitoredItemsRequest()
    request.Parameters.SubscriptionId = subscription
    request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
    change = ua.MonitoredItemModifyRequest(item.MonitoredItemId)
    for name, value in {"QueueSize": 10, **parameters}.items():
        setattr(change.RequestedParameters, name, value)
    request.Parameters.ItemsToModify = [change]
    return (await send(client, request, ua.ModifyMonitoredItemsResponse)).Results[0]


async def test_sampling_intervals_are_those_that_hold(hardened: Door) -> None:
    slow = await hardened.server.nodes.objects.add_variable(ua.NodeId("slow", 2), "slow", 0.0)
    least = ua.DataValue(ua.Variant(700.0, ua.VariantType.Double))
    await slow.write_attribute(ua.AttributeIds.MinimumSamplingInterval, least)
    async with hardened.connected() as client:
        subscription = (await create_subscription(client, RequestedPublishingInterval=40.0)).SubscriptionId
        plain = client.get_node(hardened.nodes.plain)
        cases = ((0.0, 0.0), (-1.0, 40.0), (250.0, 250.0), (1e12, 3_600_000.0), (float("nan"), 40.0))
        items = await create_items(
            client, subscription, *[watch(plain, 1, SamplingInterval=asked) for asked, _ in cases]
        )
        assert [item.RevisedSamplingInterval for item in items] == [revised for _, revised in cases]
        (item,) = await create_items(client, subscription, watch(slow, 1, SamplingInterval=0.0))
        assert item.RevisedSamplingInterval == 700.0
        for asked, revised in ((0.0, 700.0), (900.0, 900.0)):
            changed = await modify(client, subscription, item, SamplingInterval=asked)
            assert (changed.StatusCode.name, changed.RevisedSamplingInterval) == ("Good", revised)


async def test_an_item_tells_one_value_in_each_sampling_interval(hardened: Door, three: list[Any]) -> None:
    """Stock asyncua, as this server did, tells each write, whatever interval it has promised."""
    async with hardened.connected() as client:
        subscription = (await create_subscription(client)).SubscriptionId
        await create_items(
            client, subscription, watch(three[1], 1, SamplingInterval=0.0), watch(three[1], 2, SamplingInterval=400.0)
        )
        await told(client)
        for number in range(5):
            await three[1].write_value(float(number + 1))
        seen: list[tuple[int, Any]] = []
        while len(seen) < 6:
            seen += await told(client)
        assert sorted(seen) == [(1, 1.0), (1, 2.0), (1, 3.0), (1, 4.0), (1, 5.0), (2, 5.0)]


async def test_values_that_wait_for_their_time_are_bounded(
    hardened: Door, three: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An item that is modified, or disabled and enabled, again and again leaves nothing behind."""
    longest = 0
    original = MonitoredItems.hold

    def hold(self: Any, item: Any) -> None:
        nonlocal longest
        original(self, item)
        longest = max(longest, len(self._samples))

    monkeypatch.setattr(MonitoredItems, "hold", hold)
    async with hardened.connected() as client:
        subscription = (await create_subscription(client)).SubscriptionId
        (item,) = await create_items(client, subscription, watch(three[1], 1, SamplingInterval=3e6))
        for number in range(200):
            await three[1].write_value(float(number + 100))
            await modify(client, subscription, item, SamplingInterval=3e6 - number)
    assert 50 < longest <= 66


async def test_a_sampling_item_queues_and_tells_when_it_reports(hardened: Door, three: list[Any]) -> None:
    async with hardened.connected() as client:
        subscription = (await create_subscription(client, RequestedMaxKeepAliveCount=3)).SubscriptionId
        (item,) = await create_items(client, subscription, watch(three[1], 1, SAMPLING))
        await three[1].write_value(11.0)
        await three[1].write_value(12.0)
        assert await told(client) == []
        assert await set_mode(client, subscription, REPORTING, item) == ["Good"]
        assert [value for _, value in await told(client)][-2:] == [11.0, 12.0]
        await set_mode(client, subscription, SAMPLING, item)
        await three[1].write_value(13.0)
        assert await told(client) == []
        await set_mode(client, subscription, DISABLED, item)
        await three[1].write_value(14.0)
        await set_mode(client, subscription, REPORTING, item)
        assert await told(client) == [(1, 14.0)]


async def test_linked_items_are_reported_when_another_one_triggers(hardened: Door, three: list[Any]) -> None:
    first, second, third = three
    for node in three:
        await node.write_value(0.0)
    async with hardened.connected() as client:
        subscription = (await create_subscription(client, RequestedMaxKeepAliveCount=3)).SubscriptionId
        items = await create_items(
            client,
            subscription,
            watch(first, 1, QueueSize=1),
            watch(second, 2, SAMPLING, QueueSize=1),
            watch(third, 3, SAMPLING, QueueSize=1),
        )
        one, two, three_ = (item.MonitoredItemId for item in items)
        assert await told(client) == [(1, 0.0)]
        assert await trigger(client, subscription, one, [two, three_, 999], []) == (
            ["Good", "Good", "BadMonitoredItemIdInvalid"],
            [],
        )
        await second.write_value(21.0)
        assert await told(client) == []
        await first.write_value(1.0)
        assert await told(client) == [(1, 1.0), (2, 21.0), (3, 0.0)]
        await first.write_value(2.0)
        assert await told(client) == [(1, 2.0)]
        # A triggering item that only samples triggers, and is not reported.
        await set_mode(client, subscription, SAMPLING, items[0])
        await third.write_value(31.0)
        await first.write_value(3.0)
        assert await told(client) == [(3, 31.0)]
        assert await trigger(client, subscription, one, [], [three_, 999]) == (
            [],
            ["Good", "BadMonitoredItemIdInvalid"],
        )
        await third.write_value(32.0)
        await second.write_value(22.0)
        await first.write_value(4.0)
        assert await told(client) == [(2, 22.0)]


async def test_triggering_is_checked_and_bounded(hardened: Door, three: list[Any]) -> None:
    async with hardened.connected() as client:
        subscription = (await create_subscription(client)).SubscriptionId
        items = await create_items(client, subscription, *[watch(each, 1, SAMPLING) for each in three])
        one, two, last = (item.MonitoredItemId for item in items)
        assert await bad(trigger(client, subscription, one, [], [])) == "BadNothingToDo"
        assert await bad(trigger(client, subscription, 999, [one], [])) == "BadMonitoredItemIdInvalid"
        assert await bad(trigger(client, 999, one, [two], [])) == "BadSubscriptionIdInvalid"
        object.__setattr__(hardened.server.context.limits, "triggering_links", 2)
        try:
            added = ["Good", "Good", "Good", "BadTooManyMonitoredItems"]
            assert (await trigger(client, subscription, one, [two, two, last, one], []))[0] == added
            delete = ua.DeleteMonitoredItemsRequest()
            delete.Parameters.SubscriptionId = subscription
            delete.Parameters.MonitoredItemIds = [two]
            await send(client, delete, ua.DeleteMonitoredItemsResponse)
            assert (await trigger(client, subscription, last, [one, one, last], []))[0] == [*added[1:3], added[3]]
            # Links go with the item that has them.
            delete.Parameters.MonitoredItemIds = [last]
            await send(client, delete, ua.DeleteMonitoredItemsResponse)
            assert (await trigger(client, subscription, one, [one], []))[0] == ["Good"]
        finally:
            object.__setattr__(hardened.server.context.limits, "triggering_links", 1_000)


def percent(value: float) -> Any:
    trigger = ua.DataChangeTrigger.StatusValue
    return ua.DataChangeFilter(Trigger=trigger, DeadbandType=ua.DeadbandType.Percent, DeadbandValue=value)


async def test_a_deadband_in_percent_is_one_of_the_range(hardened: Door, three: list[Any]) -> None:
    node = three[0]
    await node.write_value(0.0)
    async with hardened.connected() as client:
        subscription = (await create_subscription(client)).SubscriptionId
        wrong = [watch(node, 1, Filter=percent(value)) for value in (-1.0, 100.1, float("nan"))]
        wrong.append(watch(three[1], 1, Filter=percent(10.0)))
        wrong.append(watch(client.get_node(hardened.nodes.text), 1, Filter=percent(10.0)))
        items = await create_items(client, subscription, *wrong, watch(node, 1, Filter=percent(10.0)))
        assert [item.StatusCode.name for item in items] == [
            *["BadDeadbandFilterInvalid"] * 4,
            "BadFilterNotAllowed",
            "Good",
        ]
        assert await told(client) == [(1, 0.0)]
        for value in (20.0, 20.1, 0.2, 0.0):
            await node.write_value(value)
        assert await told(client) == [(1, 20.1), (1, 0.0)]
        assert (await modify(client, subscription, items[-1], Filter=percent(1.0), ClientHandle=1)).StatusCode.is_good()
        await node.write_value(2.1)
        assert (await told(client))[-1] == (1, 2.1)


async def test_a_shorter_queue_loses_its_oldest_at_once(hardened: Door, three: list[Any]) -> None:
    async with hardened.connected() as client:
        subscription = (await create_subscription(client, RequestedMaxKeepAliveCount=3)).SubscriptionId
        (item,) = await create_items(client, subscription, watch(three[1], 1, SAMPLING))
        for number in range(5):
            await three[1].write_value(50.0 + number)
        await modify(client, subscription, item, QueueSize=2, DiscardOldest=True, ClientHandle=1)
        await set_mode(client, subscription, REPORTING, item)
        seen: list[tuple[int, Any]] = []
        while not seen:
            seen = await told(client)
        assert seen == [(1, 53.0), (1, 54.0)]


async def test_an_item_keeps_its_handle_where_a_client_leaves_it_out(hardened: Door, three: list[Any]) -> None:
    """node-opcua's client says 4294967295 then, and finds no item for what comes under that handle."""
    async with hardened.connected() as client:
        subscription = (await create_subscription(client)).SubscriptionId
        (item,) = await create_items(client, subscription, watch(three[1], 7))
        await told(client)
        for asked, handle in ((0xFFFFFFFF, 7), (8, 8)):
            await modify(client, subscription, item, ClientHandle=asked)
            await three[1].write_value(60.0 + asked)
            assert await told(client) == [(handle, 60.0 + asked)]


class Beyond(IntEnum):
    """What no enumeration of the standard has."""

    VALUE = 42


async def test_numbers_that_no_enumeration_has(hardened: Door, three: list[Any]) -> None:
    async with hardened.connected() as client:
        subscription = (await create_subscription(client)).SubscriptionId
        (item,) = await create_items(client, subscription, watch(three[1], 1))
        assert await bad(set_mode(client, subscription, Beyond.VALUE, item)) == "BadMonitoringModeInvalid"
        creating = create_items(client, subscription, watch(three[1], 1), timestamps=Beyond.VALUE)
        assert await bad(creating) == "BadTimestampsToReturnInvalid"
        request = ua.ModifyMonitoredItemsRequest()
        request.Parameters.SubscriptionId, request.Parameters.TimestampsToReturn = subscription, Beyond.VALUE
        request.Parameters.ItemsToModify = [ua.MonitoredItemModifyRequest(item.MonitoredItemId)]
        assert await bad(send(client, request, ua.ModifyMonitoredItemsResponse)) == "BadTimestampsToReturnInvalid"
