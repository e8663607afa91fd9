"""What counts as a change of a monitored item's value, and what it costs to find out."""

from __future__ import annotations

import math
import time
from datetime import UTC, datetime
from typing import Any

import pytest
from asyncua import ua
from asyncua.server.address_space import AddressSpace, AttributeValue, NodeData

from ua_fleet.endpoint import monitoring
from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.monitored_items import MonitoredItems
from ua_fleet.endpoint.monitoring import DataItem, Item
from ua_fleet.endpoint.queues import Queues
from ua_fleet.endpoint.stack import GOOD, AttributeIds, ObjectIds, ns0

SPACE: Any = None


class Owner:
    """A subscription."""

    def __init__(self) -> None:
        self.account = Queues(1 << 30, 1 << 30).account("olga")

        self.told: list[Item] = []
        self.held: list[DataItem] = []

    def pending(self, item: Item) -> None:
        self.told.append(item)

    def overflown(self, item: Item) -> None:
        pass

    def fired(self, item: Item) -> None:
        raise AssertionError(item)

    def hold(self, item: DataItem) -> None:
        self.held.append(item)


def item(deadband: float = 0.0, interval_s: float = 0.0) -> DataItem:
    request: Any = ua.MonitoredItemCreateRequest()
    request.ItemToMonitor.NodeId = ns0(ObjectIds.Server)
    request.ItemToMonitor.AttributeId = AttributeIds.Value
    request.MonitoringMode = ua.MonitoringMode.Reporting
    request.RequestedParameters.Filter = None
    both = ua.TimestampsToReturn.Both
    return DataItem(Owner(), 1, request, 100, None, both, SPACE, deadband=deadband, interval_s=interval_s)


def value(content: Any) -> ua.DataValue:
    variant = content if isinstance(content, ua.Variant) else ua.Variant(content)
    return ua.DataValue(variant, GOOD)  # pyright: ignore[reportArgumentType]


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
        (math.nan, float("nan"), 0.0, False),
        (1.0, math.nan, 0.0, True),
        (math.nan, 1.0, 0.0, True),
        (ua.Variant(None, ua.VariantType.String), "", 0.0, False),
        (ua.Variant(None, ua.VariantType.String), "a", 0.0, True),
        ("a", ua.Variant(None, ua.VariantType.String), 0.0, True),
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


class Clock:
    """A clock that is set by hand."""

    now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(monitoring, "time", made)
    return made


def told(watching: DataItem) -> list[Any]:
    return [each.Value.Value for each in watching.queue]


def write(watching: DataItem, clock: Clock, at: float, content: float) -> None:
    clock.now = 100 + at
    watching.changed(0, value(content))


def test_between_two_samples_the_last_value_waits(clock: Clock) -> None:
    watching = item(interval_s=1.0)
    write(watching, clock, 0.0, 1.0)
    write(watching, clock, 0.1, 2.0)
    write(watching, clock, 0.9, 3.0)
    assert told(watching) == [1.0]
    watching.sample(100.99)
    assert told(watching) == [1.0]
    watching.sample(101.0)
    assert told(watching) == [1.0, 3.0]
    assert not watching.holds


def test_each_sample_is_what_was_there_at_its_time(clock: Clock) -> None:
    watching = item(interval_s=1.0)
    for at, content in ((0.0, 1.0), (0.5, 2.0), (1.2, 3.0), (2.4, 3.5), (2.6, 4.0), (9.0, 5.0)):
        write(watching, clock, at, content)
    assert told(watching) == [1.0, 2.0, 3.0, 4.0, 5.0]


def test_another_interval_counts_from_the_last_sample(clock: Clock) -> None:
    watching = item(interval_s=100.0)
    write(watching, clock, 0.0, 1.0)
    write(watching, clock, 3.0, 2.0)
    watching.set_interval(2.0)
    watching.sample(103.0)
    assert told(watching) == [1.0, 2.0]
    write(watching, clock, 3.1, 3.0)
    assert watching.holds
    watching.set_interval(0.0)
    write(watching, clock, 3.2, 4.0)
    watching.sample(103.2)
    assert told(watching) == [1.0, 2.0, 3.0, 4.0]


def test_the_samples_of_many_items_are_taken_in_turns() -> None:
    space = AddressSpace()
    node_id = ns0(ObjectIds.Server)
    node = NodeData(node_id)
    space[node_id] = node
    node.attributes[AttributeIds.Value] = AttributeValue(value(0.0))
    items = MonitoredItems(space, lambda _error: None)
    account = Queues(1 << 30, 1 << 30).account("olga")

    class Whole(Owner):
        def __init__(self) -> None:
            super().__init__()
            self.account = account

        def hold(self, item: DataItem) -> None:
            items.hold(item)

    watching = [made_by(Whole(), number, space) for number in range(1, 3_001)]
    for each in watching:
        items.add_data(each)
        each.changed(0, value(1.0))
    assert all(each.holds for each in watching)
    turns = 1
    while items.sample(math.inf):
        turns += 1
    assert turns > 1
    assert not any(each.holds for each in watching)


def made_by(owner: Owner, item_id: int, space: AddressSpace) -> DataItem:
    request: Any = ua.MonitoredItemCreateRequest()
    request.ItemToMonitor.NodeId = ns0(ObjectIds.Server)
    request.ItemToMonitor.AttributeId = AttributeIds.Value
    request.MonitoringMode = ua.MonitoringMode.Reporting
    request.RequestedParameters.Filter = None
    return DataItem(owner, item_id, request, 1, None, ua.TimestampsToReturn.Both, space, interval_s=60.0)


@pytest.mark.parametrize(
    "wanted", [each for each in ua.TimestampsToReturn if each is not ua.TimestampsToReturn.Invalid]
)
@pytest.mark.parametrize("content", [1.5, "text", [1, 2], None, "x" * 2_000])
def test_several_are_told_the_bytes_that_one_is_told(content: Any, wanted: ua.TimestampsToReturn) -> None:
    def misfit(what: str, error: Exception) -> None:
        raise AssertionError(what) from error

    time: Any = datetime(2026, 1, 1, tzinfo=UTC)
    held = HeldValue(ua.DataValue(ua.Variant(content), GOOD, time, time))
    assert held.value is not None
    told = item()
    told.timestamps = wanted
    expected = told.encode(held.value, 10_000, misfit)
    told.source = held
    for watchers in (1, 2, 3):
        held.datachange_callbacks[watchers] = told.changed
        assert told.encode(held.value, 10_000, misfit) == expected
        assert (held.encoded is not None) == (watchers > 1 and len(expected) < 1_000)
    assert told.encode(held.value, 3, misfit) == told.encode(ua.DataValue(ua.Variant(content), GOOD), 3, misfit)


def test_a_value_waits_for_its_sample_while_the_list_of_samples_is_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Items that were removed leave entries in that list; once they are many, it is made of the items that hold."""
    now = 1000.0
    monkeypatch.setattr(time, "monotonic", lambda: now)
    space: Any = None
    items: Any = MonitoredItems(space, print)

    class Holder(Owner):
        def hold(self, item: DataItem) -> None:
            items.hold(item)

    one: Any = item(interval_s=1.0)
    one.owner = Holder()
    items._monitored_items[one.id] = one
    for number in range(100):  # values of other items, which are gone since
        items._samples.append((now + 0.5, 1000 + number))
    one.changed(one.id, value(1.0))
    one.changed(one.id, value(2.0))
    now += 1.0
    items.sample(now)
    assert one.last.Value.Value == 2.0
