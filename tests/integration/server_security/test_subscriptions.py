"""Subscriptions belong to one session, and tell what they should without a copy."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncGenerator
from typing import Any

import pytest
from structlog.testing import capture_logs

from tests.integration.server_security.harness import Client, Door, Stock, bad, send, ua
from tests.integration.server_security.test_limits import create_subscription, monitored
from tests.waiting import until
from ua_fleet.endpoint.node_builder import NodeBuilder
from ua_fleet.endpoint.sessions import PublishRequest
from ua_fleet.endpoint.subscriptions import ClientSubscription
from ua_fleet.endpoint.turns import TURN_S

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def create_items(client: Client, subscription: int, *items: Any, timestamps: Any = None) -> list[Any]:
    request = ua.CreateMonitoredItemsRequest()
    request.Parameters.SubscriptionId = subscription
    request.Parameters.TimestampsToReturn = timestamps or ua.TimestampsToReturn.Both
    request.Parameters.ItemsToCreate = list(items)
    return list((await send(client, request, ua.CreateMonitoredItemsResponse)).Results)


async def publish(client: Client, *acknowledged: tuple[int, int]) -> Any:
    request = ua.PublishRequest()
    request.Parameters.SubscriptionAcknowledgements = [ua.SubscriptionAcknowledgement(*pair) for pair in acknowledged]
    return (await send(client, request, ua.PublishResponse)).Parameters


def values(result: Any) -> list[Any]:
    return [
        item.Value.Value.Value for data in result.NotificationMessage.NotificationData for item in data.MonitoredItems
    ]


@contextlib.asynccontextmanager
async def watching(client: Client, node_id: Any, **options: Any) -> AsyncGenerator[tuple[int, int]]:
    """A subscription with one item: both ids."""
    subscription = (await create_subscription(client, **options)).SubscriptionId
    (item,) = await create_items(client, subscription, monitored(node_id, QueueSize=10))
    assert item.StatusCode.is_good()
    yield subscription, item.MonitoredItemId
    request = ua.DeleteSubscriptionsRequest()
    request.Parameters.SubscriptionIds = [subscription]
    await bad(send(client, request, ua.DeleteSubscriptionsResponse))


def first(response: Any) -> Any:
    return response.Results[0]


def first_parameter(response: Any) -> Any:
    return response.Parameters.Results[0]


def transferred(response: Any) -> Any:
    return response.Parameters.Results[0].StatusCode


def attacks(subscription: int, item: int, node_id: Any) -> dict[str, tuple[Any, Any, Any]]:
    """Every service that takes a subscription's id, and where its answer stands."""
    built: dict[str, tuple[Any, Any, Any]] = {}
    modify = ua.ModifySubscriptionRequest()
    modify.Parameters.SubscriptionId = subscription
    modify.Parameters.RequestedPublishingInterval = 1000.0
    built["ModifySubscription"] = modify, ua.ModifySubscriptionResponse, None
    mode = ua.SetPublishingModeRequest()
    mode.Parameters.SubscriptionIds = [subscription]
    built["SetPublishingMode"] = mode, ua.SetPublishingModeResponse, first_parameter
    create = ua.CreateMonitoredItemsRequest()
    create.Parameters.SubscriptionId = subscription
    create.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
    create.Parameters.ItemsToCreate = [monitored(node_id)]
    built["CreateMonitoredItems"] = create, ua.CreateMonitoredItemsResponse, None
    change = ua.ModifyMonitoredItemsRequest()
    change.Parameters.SubscriptionId = subscription
    change.Parameters.ItemsToModify = [ua.MonitoredItemModifyRequest(item)]
    built["ModifyMonitoredItems"] = change, ua.ModifyMonitoredItemsResponse, None
    monitoring = ua.SetMonitoringModeRequest()
    monitoring.Parameters.SubscriptionId = subscription
    monitoring.Parameters.MonitoringMode = ua.MonitoringMode.Disabled
    monitoring.Parameters.MonitoredItemIds = [item]
    built["SetMonitoringMode"] = monitoring, ua.SetMonitoringModeResponse, None
    trigger = ua.SetTriggeringRequest()
    trigger.Parameters.SubscriptionId, trigger.Parameters.TriggeringItemId = subscription, item
    trigger.Parameters.LinksToAdd = [item]
    built["SetTriggering"] = trigger, ua.SetTriggeringResponse, None
    republish = ua.RepublishRequest()
    republish.Parameters.SubscriptionId = subscription
    republish.Parameters.RetransmitSequenceNumber = 1
    built["Republish"] = republish, ua.RepublishResponse, None
    delete_items = ua.DeleteMonitoredItemsRequest()
    delete_items.Parameters.SubscriptionId = subscription
    delete_items.Parameters.MonitoredItemIds = [item]
    built["DeleteMonitoredItems"] = delete_items, ua.DeleteMonitoredItemsResponse, None
    transfer = ua.TransferSubscriptionsRequest()
    transfer.Parameters.SubscriptionIds = [subscription]
    built["TransferSubscriptions"] = (
        transfer,
        ua.TransferSubscriptionsResponse,
        transferred,
    )
    delete = ua.DeleteSubscriptionsRequest()
    delete.Parameters.SubscriptionIds = [subscription]
    built["DeleteSubscriptions"] = delete, ua.DeleteSubscriptionsResponse, first
    return built


async def attack(client: Client, request: Any, response: Any, pick: Any) -> str:
    async def run() -> Any:
        answer = await send(client, request, response)
        return pick(answer) if pick is not None else None

    return await bad(run())


async def test_nobody_else_can_touch_a_subscription(hardened: Door) -> None:
    """Stock asyncua asks nobody whose subscription it is, in any of these services."""
    async with (
        hardened.connected("oscar") as owner,
        hardened.connected("oliver") as thief,
        watching(owner, hardened.nodes.value) as (subscription, item),
    ):
        before = await publish(owner)
        for name, (request, response, pick) in attacks(subscription, item, hardened.nodes.plain).items():
            expected = "BadUserAccessDenied" if name == "TransferSubscriptions" else "BadSubscriptionIdInvalid"
            assert (name, await attack(thief, request, response, pick)) == (name, expected)
        async with watching(thief, hardened.nodes.plain):
            stolen = await publish(thief, (subscription, before.NotificationMessage.SequenceNumber))
            assert [code.name for code in stolen.Results] == ["BadSubscriptionIdInvalid"]
        assert before.NotificationMessage.SequenceNumber in before.AvailableSequenceNumbers
        await owner.get_node(hardened.nodes.value).write_value(77.0)
        after = await publish(owner)
        assert after.SubscriptionId == subscription
        assert values(after) == [77.0]
    refusals = [line["what"] for line in hardened.audit() if line["event"] == "refusal"]
    assert {"TransferSubscriptions", "DeleteSubscriptions", "Republish"} <= set(refusals)


async def test_anybody_can_touch_a_subscription_stock(plain: Stock) -> None:
    async with (
        plain.client() as owner,
        plain.client() as thief,
        watching(owner, plain.nodes.value) as (subscription, item),
    ):
        done = {
            name: await attack(thief, *parts) for name, parts in attacks(subscription, item, plain.nodes.plain).items()
        }
    assert {"DeleteSubscriptions", "TransferSubscriptions", "DeleteMonitoredItems", "SetMonitoringMode"} <= {
        name for name, result in done.items() if result == "Good"
    }


async def test_owner_transfers_a_subscription(hardened: Door) -> None:
    """The same user with the same certificate may; the old session is told, and has it no more."""
    async with (
        hardened.connected() as old,
        hardened.connected() as new,
        watching(old, hardened.nodes.value) as (subscription, item),
    ):
        request, response, pick = attacks(subscription, item, hardened.nodes.value)["TransferSubscriptions"]
        request.Parameters.SendInitialValues = True
        first = await publish(old)
        waiting = asyncio.ensure_future(publish(old))
        await asyncio.sleep(0.03)
        assert await attack(new, request, response, pick) == "Good"
        told = (await waiting).NotificationMessage.NotificationData
        assert [data.Status.name for data in told] == ["GoodSubscriptionTransferred"]
        moved = await publish(new)
        assert (moved.SubscriptionId, values(moved)) == (subscription, values(first))
        assert await bad(publish(old)) == "BadNoSubscription"
        delete, response, pick = attacks(subscription, item, hardened.nodes.value)["DeleteSubscriptions"]
        assert await attack(new, delete, response, pick) == "Good"


async def test_subscriptions_left_behind_are_bounded(hardened: Door) -> None:
    """CloseSession without deletion leaves no more subscriptions than one session may have."""
    object.__setattr__(hardened.server.context.limits, "subscriptions_per_session", 3)
    try:
        for _ in range(3):
            client = await hardened.client("oliver")
            await client.connect()
            await create_subscription(client)
            await create_subscription(client)
            await client.uaclient.close_session(False)
            for task in (client._stale_watchdog_task, client._supervisor_task, client._renew_channel_task):
                await client._cancel_task(task)
            client.disconnect_socket()
        registry: dict[int, Any] = hardened.server.iserver.subscription_service.subscriptions
        left = [sub for sub in registry.values() if sub.owner.name == "oliver"]
        assert len(left) == 3
        for sub in left:
            await sub.stop()
            registry.pop(sub.id)
    finally:
        object.__setattr__(hardened.server.context.limits, "subscriptions_per_session", 50)


async def test_notifications_in_portions(hardened: Door, plain: Stock) -> None:
    """Stock asyncua ignores MaxNotificationsPerPublish: one giant response."""

    async def portions(client: Client, node_id: Any) -> tuple[list[int], list[bool]]:
        subscription = (await create_subscription(client, MaxNotificationsPerPublish=4)).SubscriptionId
        await create_items(client, subscription, *[monitored(node_id) for _ in range(10)])
        sizes: list[int] = []
        more: list[bool] = []
        while sum(sizes) < 10:
            result = await publish(client)
            sizes.append(len(values(result)))
            more.append(result.MoreNotifications)
        return [size for size in sizes if size], more[-3:]

    async with hardened.connected() as client:
        sizes, more = await portions(client, hardened.nodes.plain)
        assert max(sizes) <= 4
        assert more[-1] is False
        assert True in more
    async with plain.client() as client:
        assert max((await portions(client, plain.nodes.plain))[0]) == 10


async def test_republish(hardened: Door) -> None:
    """Stock asyncua answers Good and nothing for numbers that it does not have, and forgets what it resends."""
    async with hardened.connected() as client, watching(client, hardened.nodes.plain) as (subscription, item):
        sent = (await publish(client)).NotificationMessage
        request, response, _ = attacks(subscription, item, hardened.nodes.plain)["Republish"]
        for _ in range(2):
            request.Parameters.RetransmitSequenceNumber = sent.SequenceNumber
            again = (await send(client, request, response)).NotificationMessage
            assert again.SequenceNumber == sent.SequenceNumber
            assert again.NotificationData[0].MonitoredItems[0].Value.Value.Value == 7.0
        request.Parameters.RetransmitSequenceNumber = 999
        assert await bad(send(client, request, response)) == "BadMessageNotAvailable"


async def test_too_many_publish_requests(hardened: Door) -> None:
    async with hardened.connected() as client, watching(client, hardened.nodes.plain):
        await publish(client)
        waiting = [asyncio.ensure_future(bad(publish(client))) for _ in range(15)]
        done, _ = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        assert {task.result() for task in done} == {"BadTooManyPublishRequests"}
        for task in waiting:
            task.cancel()
        await asyncio.gather(*waiting, return_exceptions=True)


async def test_lifetime_without_publish_requests_ends(hardened: Door) -> None:
    async with hardened.connected() as client:
        subscription = (
            await create_subscription(client, RequestedMaxKeepAliveCount=1, RequestedLifetimeCount=3)
        ).SubscriptionId
        for _ in range(100):
            if subscription not in hardened.server.iserver.subscription_service.subscriptions:
                break
            await asyncio.sleep(0.02)
        told = await publish(client)
        assert told.SubscriptionId == subscription
        (change,) = told.NotificationMessage.NotificationData
        assert change.Status.name == "BadTimeout"
        assert await bad(publish(client)) == "BadNoSubscription"


async def test_a_session_is_told_later_that_its_subscription_has_gone(hardened: Door) -> None:
    """Without a Publish request the StatusChangeNotification waits for the next one, and takes no sequence number."""
    async with (
        hardened.connected() as old,
        hardened.connected() as new,
        watching(old, hardened.nodes.value) as (subscription, item),
    ):
        first = await publish(old)
        request, response, pick = attacks(subscription, item, hardened.nodes.value)["TransferSubscriptions"]
        request.Parameters.SendInitialValues = True
        assert await attack(new, request, response, pick) == "Good"
        moved = await publish(new)
        assert moved.NotificationMessage.SequenceNumber == first.NotificationMessage.SequenceNumber + 1
        assert moved.AvailableSequenceNumbers == [1, 2]
        told = await publish(old)
        assert [data.Status.name for data in told.NotificationMessage.NotificationData] == [
            "GoodSubscriptionTransferred"
        ]
        assert told.SubscriptionId == subscription
        assert await bad(publish(old)) == "BadNoSubscription"
        delete, response, pick = attacks(subscription, item, hardened.nodes.value)["DeleteSubscriptions"]
        assert await attack(new, delete, response, pick) == "Good"


async def test_requests_that_wait_are_answered_when_the_session_is_closed(hardened: Door) -> None:
    async with hardened.connected() as client, watching(client, hardened.nodes.plain):
        await publish(client)
        waiting = asyncio.ensure_future(bad(publish(client)))
        await client.get_node(hardened.nodes.plain).read_value()  # after that the server has the request that waits
        await send(client, ua.CloseSessionRequest(), ua.CloseSessionResponse)
        assert await waiting == "BadSessionClosed"


async def test_cycles_without_publish_requests_end_a_quiet_subscription(hardened: Door) -> None:
    """Each publishing cycle counts, not only those with something to tell (OPC 10000-4 5.14.1.1)."""
    async with hardened.connected() as client:
        created = await create_subscription(
            client, RequestedPublishingInterval=1000, RequestedMaxKeepAliveCount=20, RequestedLifetimeCount=60
        )
        assert (created.RevisedMaxKeepAliveCount, created.RevisedLifetimeCount) == (20, 60)
        await publish(client)
        subscription: Any = hardened.server.iserver.subscription_service.subscriptions[created.SubscriptionId]
        cycles = 1
        while await subscription._cycle():
            cycles += 1
        assert cycles == 60


async def test_a_subscription_that_fails_is_logged_and_its_client_told(
    hardened: Door, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: object) -> None:
        raise KeyError("a mistake")

    async with hardened.connected() as client, watching(client, hardened.nodes.plain) as (subscription, item):
        await publish(client)
        waiting = asyncio.ensure_future(publish(client))
        request, response, _ = attacks(subscription, item, hardened.nodes.plain)["SetPublishingMode"]
        await send(client, request, response)  # after that the server has the request that waits
        with capture_logs() as logs:
            monkeypatch.setattr(ClientSubscription, "_cycle", broken)
            async with asyncio.timeout(60):
                (change,) = (await waiting).NotificationMessage.NotificationData
        assert change.Status.name == "BadInternalError"
        assert [(log["loop"], log["subscription"]) for log in logs] == [("subscriptions", subscription)]
        assert logs[0]["exc_info"]
        assert await bad(publish(client)) == "BadNoSubscription"


@pytest.mark.parametrize(
    ("make", "status"),
    [
        (ua.EventFilter, "BadFilterNotAllowed"),
        (ua.AggregateFilter, "BadMonitoredItemFilterUnsupported"),
        (lambda: ua.DataChangeFilter(DeadbandType=ua.DeadbandType.Percent), "BadDeadbandFilterInvalid"),
        (
            lambda: ua.DataChangeFilter(DeadbandType=ua.DeadbandType.Absolute, DeadbandValue=-1.0),
            "BadDeadbandFilterInvalid",
        ),
        (
            lambda: ua.DataChangeFilter(DeadbandType=ua.DeadbandType.Absolute, DeadbandValue=float("nan")),
            "BadDeadbandFilterInvalid",
        ),
        (lambda: ua.DataChangeFilter(DeadbandType=77), "BadDeadbandFilterInvalid"),
    ],
)
async def test_filters_are_checked(hardened: Door, make: Any, status: str) -> None:
    """Stock asyncua keeps a wrong filter and fails at each write to the node."""
    async with hardened.connected() as client:
        subscription = (await create_subscription(client)).SubscriptionId
        item = monitored(hardened.nodes.value, Filter=make())
        assert [str(r.StatusCode.name) for r in await create_items(client, subscription, item)] == [status]


async def test_event_filters_cannot_run_in_circles(hardened: Door) -> None:
    """Stock asyncua evaluates an element that refers to itself until the recursion limit, at each event."""
    async with hardened.connected() as client:
        subscription = (await create_subscription(client)).SubscriptionId

        def filtered(*elements: Any) -> Any:
            item = monitored(ua.NodeId(ua.ObjectIds.Server))
            item.ItemToMonitor.AttributeId = ua.AttributeIds.EventNotifier
            wanted = ua.EventFilter()
            wanted.WhereClause.Elements = list(elements)
            item.RequestedParameters.Filter = wanted
            return item

        def element(operator: Any, *operands: Any) -> Any:
            built = ua.ContentFilterElement(operator)
            built.FilterOperands = list(operands)
            return built

        circle = element(ua.FilterOperator.Not, ua.ElementOperand(0))
        doubling = [
            element(ua.FilterOperator.And, ua.ElementOperand(i + 1), ua.ElementOperand(i + 1)) for i in range(40)
        ]
        doubling.append(element(ua.FilterOperator.IsNull, ua.LiteralOperand(ua.Variant(1))))
        of_type = element(
            ua.FilterOperator.OfType, ua.LiteralOperand(ua.Variant(ua.NodeId(ua.ObjectIds.BaseEventType)))
        )
        results = await create_items(client, subscription, filtered(circle), filtered(*doubling), filtered(of_type))
        assert [str(result.StatusCode.name) for result in results] == [
            "BadMonitoredItemFilterInvalid",
            "BadMonitoredItemFilterInvalid",
            "Good",
        ]


async def test_events_of_subtypes_are_told(hardened: Door) -> None:
    """Stock asyncua's OfType compares exactly."""
    told: asyncio.Queue[Any] = asyncio.Queue()

    class Events:
        def event_notification(self, event: Any) -> None:
            told.put_nowait(event.Message.Text)

    generator = await hardened.server.get_event_generator(ua.ObjectIds.SystemEventType)
    async with hardened.connected() as client:
        subscription = await client.create_subscription(20, Events())
        await subscription.subscribe_events(evtypes=ua.ObjectIds.BaseEventType)
        await generator.trigger(message="hello")
        assert await asyncio.wait_for(told.get(), 2) == "hello"
        await subscription.delete()


async def test_values_are_not_copied_and_last_ones_arrive(hardened: Door) -> None:
    """Stock asyncua copies every DataValue deeply; here the one that was written is told as it is."""
    async with hardened.connected() as client:
        subscription = (await create_subscription(client)).SubscriptionId
        deadband = ua.DataChangeFilter(ua.DataChangeTrigger.StatusValue, ua.DeadbandType.Absolute, 1.0)
        created = await create_items(
            client,
            subscription,
            monitored(hardened.nodes.value, QueueSize=2),
            monitored(hardened.nodes.value, QueueSize=10, Filter=deadband, ClientHandle=2),
        )
        assert all(result.StatusCode.is_good() for result in created)
        await publish(client)
        node = hardened.server.get_node(hardened.nodes.value)
        for value in (100.0, 100.6, 101.2, 101.9, 102.5):
            await node.write_value(value)
        registry: dict[int, Any] = hardened.server.iserver.subscription_service.subscriptions
        first = next(iter(registry[subscription].items))
        written = hardened.server.iserver.aspace.read_attribute_value(hardened.nodes.value, ua.AttributeIds.Value)
        assert first.last is written
        told: dict[int, list[float]] = {0: [], 2: []}
        while len(told[2]) < 3:
            for data in (await publish(client)).NotificationMessage.NotificationData:
                for item in data.MonitoredItems:
                    told[item.ClientHandle].append(item.Value.Value.Value)
        assert told[0][-1] == 102.5
        # The deadband is measured from what was told last, so that slow drifts are seen.
        assert told[2] == [100.0, 101.2, 102.5]


async def test_deleted_nodes_do_no_harm(hardened: Door) -> None:
    gone = await hardened.server.nodes.objects.add_variable(ua.NodeId("gone", 2), "gone", 1)
    async with hardened.connected() as client, watching(client, gone.nodeid) as (_, _item):
        await publish(client)
        NodeBuilder(hardened.server.iserver.aspace).remove(gone.nodeid)
        result = await publish(client)
        item = result.NotificationMessage.NotificationData[0].MonitoredItems[0]
        assert str(item.Value.StatusCode.name) == "BadNodeIdUnknown"


async def test_others_have_a_turn_between_the_answers_of_many_subscriptions(
    hardened: Door, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of a user that were due at once were answered in one go of the event loop, which held all others up."""
    turn = 0
    turns: list[int] = []
    really = ClientSubscription.answer

    def slow(self: ClientSubscription, request: PublishRequest) -> bool:
        turns.append(turn)
        time.sleep(3 * TURN_S)
        return really(self, request)

    async def others() -> None:
        nonlocal turn
        while True:
            turn += 1
            await asyncio.sleep(0)

    async with hardened.connected() as client:
        ids = [(await create_subscription(client)).SubscriptionId for _ in range(8)]
        for _ in ids:
            await publish(client)  # the first message of each
        registered: Any = hardened.server.iserver.subscription_service.subscriptions
        mine = [registered[each] for each in ids]
        waiting = [asyncio.create_task(publish(client)) for _ in ids]
        await until(lambda: len(mine[0].session.requests) >= 8, "eight Publish requests")
        other = asyncio.create_task(others())
        monkeypatch.setattr(ClientSubscription, "answer", slow)
        for each in mine:
            each._quiet_cycles = each.keep_alive_count
            each._changed.set()
        await asyncio.gather(*waiting)
        other.cancel()
    assert len(set(turns[:8])) == 8


async def test_what_is_kept_counts_for_the_user(hardened: Door) -> None:
    """It counted for each session: ten of them kept ten times as much."""
    async with hardened.connected("olga") as one, hardened.connected("olga") as other:
        registry: Any = hardened.server.iserver.subscription_service
        kept = [registry.find((await create_subscription(client)).SubscriptionId) for client in (one, other, other)]
        assert len({subscription.session.key for subscription in kept}) == 2
        body = bytes(1_000_000)
        for number in range(40):
            kept[number % 2]._keep(number + 1, body)
        kept[2]._keep(1, body)
        assert sum(subscription.kept_bytes for subscription in kept) <= 16 * 1024 * 1024
        assert kept[2].kept_bytes == 1_000_000, "who keeps most gives way"
