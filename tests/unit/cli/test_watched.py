"""What `watch` tells of the values that came."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from ua_fleet.cli.value_text import ValueStyle
from ua_fleet.cli.watched import WINDOW_S, Watched
from ua_fleet.client import Reading, SelectedNode
from ua_fleet.values import StatusCode

NOON = datetime(2030, 1, 31, 12, tzinfo=UTC)
BATTERY = SelectedNode("ns=2;i=1", "rover/battery")
SPEED = SelectedNode("ns=2;i=2", "rover/speed", is_named=False)


def reading(node: SelectedNode, value: float | None, status: int = 0, after_s: float = 0.0) -> Reading:
    return Reading(node.node_id, value, "Double", status, NOON + timedelta(seconds=after_s), None)


def shown(watched: Watched, now: float, *, with_rate: bool = False, with_age: bool = False) -> list[list[str]]:
    rows, _ = watched.rows(now, NOON + timedelta(seconds=now), UTC, with_rate=with_rate, with_age=with_age)
    return [[cell.text for cell in row] for row in rows]


def test_the_last_value_of_each_node_in_the_order_that_was_asked_for() -> None:
    watched = Watched([SPEED, BATTERY], {BATTERY.node_id: ValueStyle("%")}, now=0)
    watched.take(reading(BATTERY, 90.0), 0)
    watched.take(reading(BATTERY, 89.0, StatusCode.BAD_NO_COMMUNICATION, 2), 2)
    watched.take(reading(SPEED, 1.0), 2)
    assert shown(watched, 3, with_age=True) == [
        ["node", "value", "age", "status"],
        ["rover/speed", "1.0", "3.0 s", ""],
        ["rover/battery", "89.0 %", "1.0 s", "BadNoCommunication"],
    ]
    assert shown(watched, 3)[2][2] == "12:00:02.000"


def test_the_rate_counts_what_came_in_the_last_seconds_and_not_the_first_value() -> None:
    watched = Watched([BATTERY], {}, now=0)
    watched.take(reading(BATTERY, 1.0), 0)
    assert watched.rates(0.5) == [(BATTERY, 0.0, 0)]
    for tick in range(1, 101):
        watched.take(reading(BATTERY, 1.0, after_s=tick / 10), tick / 10)
    assert watched.rates(10) == [(BATTERY, 10.0, 100)]
    assert shown(watched, 10, with_rate=True)[1][2] == "10.0"
    assert watched.rates(10 + WINDOW_S) == [(BATTERY, 0.0, 100)]


def test_the_rate_of_the_first_seconds_is_over_these_seconds() -> None:
    watched = Watched([BATTERY], {}, now=0)
    for tick in range(21):
        watched.take(reading(BATTERY, 1.0), tick / 10)
    assert watched.rates(2)[0][1] == 10.0


def test_what_is_below_an_object_and_never_came_is_counted_and_not_shown() -> None:
    watched = Watched([BATTERY, SPEED], {}, now=0)
    watched.take(reading(BATTERY, None, StatusCode.BAD_WAITING_FOR_INITIAL_DATA), 0)
    watched.take(reading(SPEED, None, StatusCode.BAD_WAITING_FOR_INITIAL_DATA), 0)
    rows, waiting = watched.rows(0, NOON, UTC, with_rate=False, with_age=False)
    assert [row[0].text for row in rows] == ["node", "rover/battery"]
    assert waiting == 1
