"""EventFilters as OPC 10000-4 7.22.3 has them, asked through asyncua's client."""

from __future__ import annotations

from typing import Any

import pytest

from tests.integration.server_security.harness import Client, Door, send, ua
from tests.integration.server_security.test_limits import create_subscription, monitored
from tests.integration.server_security.test_monitored_items import modify
from tests.integration.server_security.test_subscriptions import create_items, publish

pytestmark = pytest.mark.asyncio(loop_scope="module")

BASE = ua.NodeId(ua.ObjectIds.BaseEventType)


def clause(*path: str, kind: Any = BASE, attribute: Any = ua.AttributeIds.Value, index_range: str = "") -> Any:
    made = ua.SimpleAttributeOperand()
    made.TypeDefinitionId, made.AttributeId, made.IndexRange = kind, attribute, index_range
    made.BrowsePath = [ua.QualifiedName(name, 0) for name in path]
    return made


def element(operator: Any, *operands: Any) -> Any:
    made = ua.ContentFilterElement(operator)
    made.FilterOperands = list(operands)
    return made


def events(select: list[Any], *where: Any, attribute: Any = ua.AttributeIds.EventNotifier) -> Any:
    wanted = ua.EventFilter()
    wanted.SelectClauses, wanted.WhereClause.Elements = select, list(where)
    item = monitored(ua.NodeId(ua.ObjectIds.Server), Filter=wanted, ClientHandle=5)
    item.ItemToMonitor.AttributeId = attribute
    return item


async def create(client: Client, *items: Any) -> Any:
    subscription = (await create_subscription(client)).SubscriptionId
    return subscription, await create_items(client, subscription, *items)


def names(codes: Any) -> list[str]:
    return [code.name for code in codes]


async def test_each_select_clause_has_its_result(hardened: Door) -> None:
    """The item is made, and says which clauses select nothing of any event."""
    alarm = ua.NodeId(ua.ObjectIds.AlarmConditionType)
    cases = (
        (clause("EventId"), "Good"),
        (clause("Message", index_range="0:1"), "Good"),
        (clause("ActiveState", "Id"), "Good"),  # of a subtype: BaseEventType stands for any type
        (clause("Severity", kind=alarm), "Good"),  # inherited
        (clause(kind=ua.NodeId(ua.ObjectIds.ConditionType), attribute=ua.AttributeIds.NodeId), "Good"),
        (clause("EventId", kind=ua.NodeId()), "Good"),
        (clause("Nonsense"), "BadNodeIdUnknown"),
        (clause("EventId", "Nonsense"), "BadNodeIdUnknown"),
        (clause("EventId", kind=ua.NodeId("nowhere", 1)), "BadNodeIdUnknown"),
        (clause("EventId", kind=ua.NodeId(ua.ObjectIds.ServerType)), "BadTypeDefinitionInvalid"),
        (clause("EventId", ""), "BadBrowseNameInvalid"),
        (clause("EventId", attribute=99), "BadAttributeIdInvalid"),
        (clause("EventId", attribute=ua.AttributeIds.NodeClass), "BadAttributeIdInvalid"),
        (clause(attribute=ua.AttributeIds.Value), "BadAttributeIdInvalid"),
        (clause("EventId", index_range="2:1"), "BadIndexRangeInvalid"),
    )
    async with hardened.connected() as client:
        _, (item,) = await create(client, events([made for made, _ in cases]))
        assert item.StatusCode.name == "Good"
        assert names(item.FilterResult.SelectClauseResults) == [code for _, code in cases]
        assert item.FilterResult.WhereClauseResult.ElementResults == []


async def test_each_element_of_a_where_clause_has_its_result(hardened: Door) -> None:
    one = ua.LiteralOperand(ua.Variant(1))
    good = element(ua.FilterOperator.IsNull, one)
    cases: tuple[tuple[Any, str, list[str]], ...] = (
        (element(ua.FilterOperator.Not, ua.ElementOperand(0)), "BadFilterElementInvalid", ["BadFilterElementInvalid"]),
        (element(ua.FilterOperator.Equals, one), "BadFilterOperandCountMismatch", []),
        (element(ua.FilterOperator.Equals, one, one, one), "BadFilterOperandCountMismatch", []),
        (element(ua.FilterOperator.Like, one, one), "BadFilterLiteralInvalid", ["Good", "BadFilterLiteralInvalid"]),
        (element(ua.FilterOperator.InView, one), "BadFilterOperatorUnsupported", []),
    )
    async with hardened.connected() as client:
        _, made = await create(client, *[events([clause("EventId")], wrong, good) for wrong, _, _ in cases])
        for item, (_, code, operands) in zip(made, cases, strict=True):
            unsupported = code == "BadFilterOperatorUnsupported"
            expected = "BadMonitoredItemFilterUnsupported" if unsupported else "BadMonitoredItemFilterInvalid"
            assert item.StatusCode.name == expected
            first, second = item.FilterResult.WhereClauseResult.ElementResults
            assert (first.StatusCode.name, names(first.OperandStatusCodes)) == (code, operands)
            assert second.StatusCode.name == "Good"
            assert names(item.FilterResult.SelectClauseResults) == ["Good"]


async def test_filters_go_with_their_attribute(hardened: Door) -> None:
    changes = events([], attribute=ua.AttributeIds.EventNotifier)
    changes.RequestedParameters.Filter = ua.DataChangeFilter()
    many = events([clause("EventId")], element(ua.FilterOperator.InList, *[ua.LiteralOperand(ua.Variant(1))] * 201))
    async with hardened.connected() as client:
        on_value = events([clause("EventId")], attribute=ua.AttributeIds.Value)
        on_value.ItemToMonitor.NodeId = hardened.nodes.value
        on_name = events([clause("EventId")], attribute=ua.AttributeIds.BrowseName)
        _, made = await create(client, on_value, on_name, changes, many)
        assert names(item.StatusCode for item in made) == [*["BadFilterNotAllowed"] * 3, "BadEventFilterInvalid"]
        assert [getattr(item.FilterResult, "SelectClauseResults", None) for item in made] == [None] * 4


async def test_an_event_item_without_a_filter_selects_nothing(hardened: Door) -> None:
    item = events([])
    item.RequestedParameters.Filter = ua.ExtensionObject()
    generator = await hardened.server.get_event_generator(ua.ObjectIds.SystemEventType)
    async with hardened.connected() as client:
        subscription, (made,) = await create(client, item)
        assert made.StatusCode.name == "Good"
        await generator.trigger(message="hello")
        data = (await publish(client)).NotificationMessage.NotificationData
        while not data:
            data = (await publish(client)).NotificationMessage.NotificationData
        assert [list(event.EventFields) for event in data[0].Events] == [[]]
        # A filter that comes later holds from then on, and is checked like the first one.
        wanted = events([clause("Message"), clause("Nonsense"), clause("Message", attribute=1)]).RequestedParameters
        changed = await modify(client, subscription, made, Filter=wanted.Filter)
        assert names(changed.FilterResult.SelectClauseResults) == ["Good", "BadNodeIdUnknown", "BadAttributeIdInvalid"]
        await generator.trigger(message="again")
        data = (await publish(client)).NotificationMessage.NotificationData
        while not data:
            data = (await publish(client)).NotificationMessage.NotificationData
        ((message, nothing, neither),) = [event.EventFields for event in data[0].Events]
        assert message.Value.Text == "again"
        assert (nothing.Value, neither.Value) == (None, None)
        circle = events([], element(ua.FilterOperator.Not, ua.ElementOperand(0))).RequestedParameters
        changed = await modify(client, subscription, made, Filter=circle.Filter)
        assert changed.StatusCode.name == "BadMonitoredItemFilterInvalid"
        assert len(changed.FilterResult.WhereClauseResult.ElementResults) == 1


async def test_a_subscription_that_is_taken_over_counts_in_its_new_session(hardened: Door) -> None:
    """A user could gather more event items in one session than it may make there."""
    limits = hardened.server.context.limits
    most = limits.event_items_per_session
    object.__setattr__(limits, "event_items_per_session", 1)
    try:
        async with hardened.connected() as one, hardened.connected() as two:
            moving, _ = await create(one, events([clause("EventId")]))
            await create(two, events([clause("EventId")]))
            request = ua.TransferSubscriptionsRequest()
            request.Parameters.SubscriptionIds = [moving]
            results = (await send(two, request, ua.TransferSubscriptionsResponse)).Parameters.Results
            assert [result.StatusCode.name for result in results] == ["BadTooManyMonitoredItems"]
    finally:
        object.__setattr__(limits, "event_items_per_session", most)
