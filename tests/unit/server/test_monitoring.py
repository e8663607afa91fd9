"""What counts as a change of a monitored item's value, and what it costs to find out."""

from __future__ import annotations

import math
from typing import Any

import pytest
from asyncua import ua

from ua_fleet.server.endpoint.monitoring import DataItem, Item
from ua_fleet.server.endpoint.queues import Queues
from ua_fleet.server.endpoint.stack import GOOD, AttributeIds, ObjectIds, ns0

SPACE: Any = None


class Owner:
    """A subscription."""

    def __init__(self) -> None:
        self.account = Queues(1 << 30, 1 << 30).account("olga")

    def pending(self, item: Item) -> None:
        pass


def item(deadband: float = 0.0) -> DataItem:
    request: Any = ua.MonitoredItemCreateRequest()
    request.ItemToMonitor.NodeId = ns0(ObjectIds.Server)
    request.ItemToMonitor.AttributeId = AttributeIds.Value
    request.MonitoringMode = ua.MonitoringMode.Reporting
    request.RequestedParameters.Filter = None
    if deadband:
        request.RequestedParameters.Filter = ua.DataChangeFilter(
            ua.DataChangeTrigger.StatusValue, ua.DeadbandType.Absolute, deadband
        )
    return DataItem(Owner(), 1, request, 100, None, ua.TimestampsToReturn.Both, SPACE)


def value(content: Any) -> ua.DataValue:
    return ua.DataValue(ua.Variant(content), GOOD)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("before", "now", "deadband", "is_told"),
    [
        (1.0, 1.0, 0.0, False),
        (1.0, 1.5, 0.0, True),
        (1.0, 1.5, 0.5, False),
        (1.0, 1.6, 0.5, True),
        (1.0, math.nan, 9.0, True),
        ([1.0, 2.0], [1.0, 2.0], 0.0, False),
        ([1.0, 2.0], [1.0, 2.1], 0.0, True),
        ([1.0, 2.0], [1.1, 1.9], 0.2, False),
        ([1.0, 2.0], [1.0, 1.7], 0.2, True),
        ([1.0, 2.0], [1.0, math.nan], 9.0, True),
        ([1.0, math.nan], [1.0, 5.0], 9.0, True),
        ([1.0, 2.0], [1.0], 9.0, True),
        ([math.inf], [-math.inf], 9.0, True),
        ("a", "b", 0.0, True),
    ],
)
def test_what_is_told(before: Any, now: Any, deadband: float, is_told: bool) -> None:
    watching = item(deadband)
    watching.changed(0, value(before))
    watching.changed(0, value(now))
    assert len(watching.queue) == 1 + is_told


class Counting(float):
    """A number that counts how often it was held against another."""

    compared = 0

    def __rsub__(self, other: float) -> float:
        Counting.compared += 1
        return 1.0

    def __eq__(self, other: object) -> bool:
        Counting.compared += 1
        return False

    __hash__ = float.__hash__


@pytest.mark.parametrize("deadband", [0.0, 1e300])
def test_an_array_is_compared_once_for_all_items(deadband: float) -> None:
    """A thousand items on one array of 5,000 numbers held up everybody for 2.6 s at each write."""
    watching = [item(deadband) for _ in range(100)]
    first, second = value([0.0] * 50), value([Counting(5)] * 50)
    for each in watching:
        each.changed(0, first)
    Counting.compared = 0
    for each in watching:
        each.changed(0, second)
    assert 0 < Counting.compared <= 100
