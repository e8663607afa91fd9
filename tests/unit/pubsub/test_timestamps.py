"""The clock of a bridge was ahead, and is set right: which Timestamps its values have, and who takes them."""

from __future__ import annotations

from typing import Final

import pytest

from tests.unit.pubsub.publishing import CODEC, FIELDS, TOPIC, WALL, Reading, messages
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub import (
    DataReceived,
    Publisher,
    PubSubTiming,
    SourceReturned,
    SourceSilent,
    SourceStale,
    SubscriberEvent,
)
from ua_fleet.pubsub.timestamps import MOST_AHEAD_S, Timestamps
from ua_fleet.topics import Topic
from ua_fleet.values import TICKS_PER_SECOND, StatusCode
from ua_fleet.wire.messages import DataSetMessage

DAY_S: Final = 86_400


def publisher_of(timestamps: Timestamps | None = None) -> Publisher:
    publisher = Publisher(TOPIC.space, PubSubTiming(), Counters(), CODEC, timestamps=timestamps)
    publisher.announce(TOPIC, "level", FIELDS, now=0.0, wall_ticks=WALL)
    return publisher


def at(seconds: float) -> int:
    return WALL + round(seconds * TICKS_PER_SECOND)


def said(publisher: Publisher, timestamp: int, now: float) -> DataSetMessage:
    [message] = messages(publisher.publish(TOPIC, (1.0, "a"), timestamp=timestamp, now=now))
    return message


def test_values_have_their_own_time_again_once_the_clock_is_right() -> None:
    publisher, told = publisher_of(), list[tuple[Topic, float]]()
    publisher.timestamps.told = lambda topic, back_s: told.append((topic, back_s))
    assert said(publisher, at(DAY_S), 0.0).timestamp == at(DAY_S)
    assert said(publisher, at(1.0), 1.0).timestamp == at(1.0)
    assert said(publisher, at(1.0), 1.0).timestamp == at(1.0) + 1
    [repeat] = messages(publisher.poll(6.5))
    assert repeat.timestamp == at(1.0) + 1
    assert said(publisher, at(2 * DAY_S), 7.0).timestamp == at(2 * DAY_S)
    assert said(publisher, at(8.0), 8.0).timestamp == at(8.0)
    assert told == [(TOPIC, DAY_S - 1.0)], "once"


def test_the_clock_may_be_ahead_by_a_minute() -> None:
    publisher = publisher_of()
    said(publisher, at(MOST_AHEAD_S), 0.0)
    assert said(publisher, at(0.0), 0.0).timestamp == at(MOST_AHEAD_S) + 1


def test_an_old_time_of_a_source_is_none_of_the_clock() -> None:
    """A recording that begins anew, or two robots of one source: what was said last was not ahead."""
    publisher = publisher_of()
    said(publisher, at(DAY_S), float(DAY_S))
    assert said(publisher, at(10.0), float(DAY_S)).timestamp == at(DAY_S) + 1


def test_without_a_time_of_its_own_a_message_is_behind_the_last_one() -> None:
    publisher = publisher_of()
    said(publisher, at(DAY_S), 0.0)
    [restated] = messages(publisher.restate(TOPIC, status=int(StatusCode.UNCERTAIN), now=1.0))
    assert restated.timestamp == at(DAY_S) + 1


def test_that_a_source_is_gone_is_news_at_once() -> None:
    publisher = publisher_of()
    said(publisher, at(DAY_S), 0.0)
    [lost] = messages(publisher.source_lost(TOPIC, timestamp=at(1.0), now=1.0))
    assert lost.timestamp == at(DAY_S) + 1


def test_commands_never_go_back() -> None:
    publisher = publisher_of(Timestamps(only_increase=True))
    said(publisher, at(DAY_S), 0.0)
    assert said(publisher, at(1.0), 1.0).timestamp == at(DAY_S) + 1


def test_the_clock_that_was_polled_last_counts() -> None:
    publisher = publisher_of()
    publisher.poll(1.0, at(DAY_S))
    said(publisher, at(DAY_S), 1.0)
    assert said(publisher, at(2.0), 2.0).timestamp == at(DAY_S) + 1, "not known yet to be set right"
    publisher.poll(2.5, at(2.5))
    assert said(publisher, at(3.0), 3.0).timestamp == at(3.0)


@pytest.mark.parametrize("period_s", [0.1, 1.0, 7.0])
def test_readers_take_what_comes_after_some_seconds(period_s: float) -> None:
    """Meanwhile the source is not silent."""
    publisher, reading = publisher_of(), Reading()
    heard: list[tuple[float, SubscriberEvent]] = []

    def wall(now: float) -> int:
        return at(now + (DAY_S if now < 10.0 else 0.0))

    def hear(datagrams: list[bytes], now: float) -> None:
        heard.extend((now, event) for event in reading.receive(datagrams, now))

    hear(publisher.announce(TOPIC, "level", FIELDS, now=0.0, wall_ticks=wall(0.0)), 0.0)
    due = 0.0
    for step in range(int(40 / 0.05)):
        now = step * 0.05
        hear(publisher.poll(now, wall(now), is_round=step % 20 == 0), now)
        if now >= due:
            due += period_s
            hear(publisher.publish(TOPIC, (now, "a"), timestamp=wall(now), now=now), now)
        heard += [(now, event) for event in reading.subscriber.poll(now)]
    events = [event for _, event in heard]
    assert not [event for event in events if isinstance(event, SourceSilent)]
    stale, returned = (sum(isinstance(event, kind) for event in events) for kind in (SourceStale, SourceReturned))
    assert stale == returned <= 1
    values = [(now, event.message) for now, event in heard if isinstance(event, DataReceived)]
    first_s, first = next((now, message) for now, message in values if (message.timestamp or 0) < at(DAY_S))
    assert first_s <= 10.0 + 2 * period_s + 3.2, "MessageReceiveTimeout"
    assert first.timestamp == at(first.values[0])
    assert [message.timestamp for _, message in values[-3:]] == [at(message.values[0]) for _, message in values[-3:]]
    assert reading.counters.drops[Drop.DUPLICATE] == reading.counters.drops[Drop.LATE] == 0
