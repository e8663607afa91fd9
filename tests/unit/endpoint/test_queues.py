"""What waits for clients has a bound by user and for all, and what gives way says so."""

from __future__ import annotations

from typing import Any

import pytest
from asyncua import ua

from ua_fleet.endpoint.indexrange import parse_range
from ua_fleet.endpoint.monitoring import DataItem, Item, weight
from ua_fleet.endpoint.queues import Account, Queues, content_bytes
from ua_fleet.endpoint.stack import GOOD, AttributeIds, ObjectIds, ns0

OVERFLOW = 0x0480


class Space:
    """An address space of one node."""

    now: Any = None

    def read_attribute_value(self, _node_id: Any, _attribute: Any) -> Any:
        return self.now


class Owner:
    """A subscription."""

    def __init__(self, account: Account) -> None:
        self.account = account
        self.waiting: list[Item] = []

    def pending(self, item: Item) -> None:
        self.waiting.append(item)

    def overflown(self, item: Item) -> None:
        pass

    def fired(self, item: Item) -> None:
        raise AssertionError(item)

    def hold(self, item: Item) -> None:
        raise AssertionError(item)


def value(content: Any) -> Any:
    return ua.DataValue(ua.Variant(content), GOOD)  # pyright: ignore[reportArgumentType]


def item(account: Account, *, queue: int = 10, discard_oldest: bool = True, space: Any = None, part: str = "") -> Any:
    request: Any = ua.MonitoredItemCreateRequest()
    request.ItemToMonitor.NodeId = ns0(ObjectIds.Server)
    request.ItemToMonitor.AttributeId = AttributeIds.Value
    request.MonitoringMode = ua.MonitoringMode.Reporting
    request.RequestedParameters.Filter = None
    request.RequestedParameters.DiscardOldest = discard_oldest
    return DataItem(Owner(account), 1, request, queue, parse_range(part), ua.TimestampsToReturn.Both, space)


def text(number: int) -> Any:
    """A value that takes 1,000 bytes and some."""
    return value(f"{number:04}" * 250)


def unexpected(what: str, error: Exception) -> None:
    raise AssertionError(what) from error


ONE = weight(text(0))


def taken(one: Any) -> list[tuple[int, bool]]:
    """All that waits, as the number of the value and whether something was lost beside it."""
    found: list[tuple[int, bool]] = []
    while one.waits:
        told = one.take()
        found.append((int(told.Value.Value[:4]), bool(told.StatusCode.value & OVERFLOW)))
    return found


def test_beyond_the_budget_of_a_user_what_has_waited_longest_gives_way() -> None:
    queues = Queues(4 * ONE, 100 * ONE)
    first, second = (item(queues.account("olga")) for _ in range(2))
    other = item(queues.account("oscar"))
    for number in range(3):
        first.changed(0, text(number))
        second.changed(0, text(10 + number))
        other.changed(0, text(20 + number))
    assert (queues.lost, queues.account("olga").held_bytes) == (2, 4 * ONE)
    assert taken(first) == [(1, True), (2, False)]
    assert taken(second) == [(11, True), (12, False)]
    assert taken(other) == [(20, False), (21, False), (22, False)]
    assert queues.held_bytes == 0


def test_beyond_the_budget_of_all_the_user_with_the_most_gives_way() -> None:
    queues = Queues(100 * ONE, 6 * ONE)
    greedy, modest = item(queues.account("olga")), item(queues.account("oscar"))
    modest.changed(0, text(20))
    for number in range(8):
        greedy.changed(0, text(number))
    modest.changed(0, text(21))
    assert taken(modest) == [(20, False), (21, False)]
    assert taken(greedy) == [(4, True), (5, False), (6, False), (7, False)]


@pytest.mark.parametrize("queue", [1, 10])
def test_who_has_lost_everything_tells_the_value_of_now(queue: int) -> None:
    queues, space = Queues(2 * ONE, 100 * ONE), Space()
    first, second = (item(queues.account("olga"), queue=queue, space=space) for _ in range(2))
    first.changed(0, text(1))
    for number in range(2, 4):
        second.changed(0, text(number))
    second.changed(0, value("x" * 1500))
    assert not first.queue
    space.now = text(7)
    assert taken(first) == [(7, queue > 1)]
    assert not first.waits


def test_who_keeps_its_oldest_loses_the_newest_but_one() -> None:
    queues = Queues(3 * ONE, 100 * ONE)
    one = item(queues.account("olga"), discard_oldest=False)
    for number in range(5):
        one.changed(0, text(number))
    assert taken(one) == [(0, False), (1, False), (4, True)]


def test_a_full_queue_says_where_it_has_lost() -> None:
    queues = Queues(100 * ONE, 100 * ONE)
    oldest = item(queues.account("olga"), queue=2)
    newest = item(queues.account("olga"), queue=2, discard_oldest=False)
    for number in range(4):
        oldest.changed(0, text(number))
        newest.changed(0, text(number))
    assert taken(oldest) == [(2, True), (3, False)]
    assert taken(newest) == [(0, False), (3, True)]
    assert queues.held_bytes == queues.lost == 0


def test_what_is_forgotten_is_in_no_account() -> None:
    queues = Queues(100 * ONE, 100 * ONE)
    one = item(queues.account("olga"))
    for number in range(4):
        one.changed(0, text(number))
    one.clear()
    assert queues.held_bytes == 0
    assert not one.waits


@pytest.mark.parametrize("part", ["1:2", "0:1999"])
def test_a_part_is_cut_out_when_it_is_sent(part: str) -> None:
    """Each of 2,000 items held a copy of its part: 20 nodes of 60 KB grew the server by 2 GB in ten seconds."""
    queues = Queues(1 << 20, 1 << 20)
    one = item(queues.account("olga"), part=part)
    whole = value([0.0] * 3000)
    one.changed(0, whole)
    assert one.queue[0] is whole
    sent: bytes = one.encode(one.take(), 1 << 20, unexpected)
    first, _, last = part.partition(":")
    length = int(last) - int(first) + 1
    assert len(sent) == 4 + 1 + (1 + 4 + 8 * length) + 4


def test_a_small_part_is_told_when_it_changes_alone() -> None:
    queues = Queues(1 << 20, 1 << 20)
    one = item(queues.account("olga"), part="1:2")
    for content in ([0.0, 1.0, 2.0, 3.0], [9.0, 1.0, 2.0, 3.0], [9.0, 1.0, 5.0, 3.0]):
        one.changed(0, value(content))
    assert len(one.queue) == 2


@pytest.mark.parametrize(
    ("content", "least"),
    [
        ("x" * 1000, 1000),
        (b"x" * 1000, 1000),
        ([1.0] * 1000, 8000),
        ([[1.0] * 100] * 10, 8000),
        (["x" * 1000, None] * 10, 10_000),
        ([ua.LocalizedText("x" * 1000)] * 3, 3000),
        (ua.ExtensionObject(ns0(ObjectIds.Range), ua.ByteString(bytes(1000))), 1000),
        (None, 0),
    ],
)
def test_what_a_value_takes(content: Any, least: int) -> None:
    assert least <= content_bytes(content) <= 5 * least
