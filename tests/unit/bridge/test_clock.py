"""The clock of a bridge was ahead once: which Timestamps its space's values have."""

from __future__ import annotations

from tests.unit.bridge.test_core import START_NS, TOPIC, WALL, Bridge, data_of
from ua_fleet.bridge import SourceLost
from ua_fleet.values import ticks_from_unix_ns

DAY_NS = 86_400 * 1_000_000_000
DAY = ticks_from_unix_ns(START_NS + DAY_NS)


def test_a_clock_that_was_ahead_leaves_no_later_value_in_the_future() -> None:
    bridge = Bridge(1)
    bridge.find(TOPIC)
    bridge.read(TOPIC, 1.0, ns=DAY_NS)
    bridge.core.tell(TOPIC, (2.0,), WALL + 10, now=0.0)
    bridge.read(TOPIC, 3.0, ns=2_000)
    bridge.core.from_space(SourceLost(TOPIC), now=0.0, wall_ticks=WALL + 30)
    assert [message.timestamp for message in data_of(bridge.take())] == [DAY, WALL + 10, WALL + 20, WALL + 30]


def test_that_a_source_is_gone_is_told_with_a_later_time_although_the_clock_was_ahead() -> None:
    bridge = Bridge(1)
    bridge.find(TOPIC)
    bridge.read(TOPIC, 1.0, ns=DAY_NS)
    bridge.core.from_space(SourceLost(TOPIC), now=0.0, wall_ticks=WALL + 30)
    assert [message.timestamp for message in data_of(bridge.take())] == [DAY, DAY + 1]
