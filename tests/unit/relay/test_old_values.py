"""What a relay brings of a source that is gone, or whose clock is behind since its restart."""

from __future__ import annotations

import pytest

from tests.unit.pubsub.publishing import CODEC, FIELDS, TOPIC, WALL
from tests.unit.pubsub.security.securing import NONE
from tests.unit.relay.between import SITE, Between
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub import DataReceived, ProbeDue, Publisher, PubSubTiming, SourceUnknown, SubscriberEvent
from ua_fleet.relay import Forwarded
from ua_fleet.transport.mqtt.core import MqttCore
from ua_fleet.transport.mqtt.outbox import Outbox
from ua_fleet.transport.mqtt.topics import TopicTree
from ua_fleet.transport.party import Party
from ua_fleet.values import TICKS_PER_SECOND


def values(events: list[SubscriberEvent]) -> list[float]:
    return [event.message.values[0] for event in events if isinstance(event, DataReceived)]


def test_a_bridge_whose_clock_is_behind_since_its_restart_is_heard_again() -> None:
    """The version of its metadata is older than that of its life before, which the reader knows."""
    between = Between(mode=NONE)
    writing = between.writing
    between.carry(writing.publisher.announce(TOPIC, "speed", FIELDS, now=writing.now, wall_ticks=WALL))
    assert values(between.carry(writing.publish(1.5, timestamp=WALL))) == [1.5]
    writing.now += 10.0
    writing.publisher = Publisher(TOPIC.space, PubSubTiming(), Counters(), CODEC)
    wall = WALL - 3_600 * TICKS_PER_SECOND
    between.carry(writing.publisher.announce(TOPIC, "speed", FIELDS, now=writing.now, wall_ticks=wall))
    heard: list[float] = []
    for _ in range(20):
        writing.now += 1.0
        wall += TICKS_PER_SECOND
        heard += values(between.carry(writing.publisher.poll(writing.now, wall)))
        heard += values(between.carry(writing.publish(2.5, timestamp=wall)))
        for event in between.subscriber.poll(writing.now):
            if isinstance(event, ProbeDue | SourceUnknown) and event.datagram is not None:
                heard += values(between.heard(between.relay.receive(SITE, event.datagram, writing.now)))
    assert heard[-1:] == [2.5]
    assert set(heard) <= {1.5, 2.5}


class Broker:
    """What stands between the relay and the reader."""

    def __init__(self, between: Between) -> None:
        self._between = between
        party = Party(
            publisher_id=None,
            seal=lambda plain, _: [plain],
            token=lambda _: 0,
            is_secured=False,
            names_of=lambda _: None,
            names_of_origin=between.relay.names_of,
            receive_kept=lambda _kept, _topic: None,
        )
        self.core = MqttCore(party, TopicTree(), Outbox())

    def put(self, forwarded: list[Forwarded]) -> None:
        for to, plain in forwarded:
            if to == SITE:
                self.core.send(plain, plain, None, self._between.now, WALL)

    def passed_on(self) -> list[SubscriberEvent]:
        events: list[SubscriberEvent] = []
        for outgoing in self.core.take(self._between.now):
            events += self._between.subscriber.receive(outgoing.payload, self._between.now)
            self.core.acknowledged(outgoing.parcel)
        return events


@pytest.mark.parametrize(("away_s", "comes"), [(2.0, [2.5]), (3_600.0, [])])
def test_a_value_that_waited_for_a_broker_is_not_said_of_a_source_that_may_be_gone(
    away_s: float, comes: list[float]
) -> None:
    between = Between(mode=NONE, takes_one=True)
    broker = Broker(between)
    broker.core.connected(between.now)
    broker.put(between.said(between.writing.announce()))
    broker.put(between.said(between.writing.publish(1.5, timestamp=WALL)))
    assert values(broker.passed_on()) == [1.5]
    broker.core.disconnected()
    broker.put(between.said(between.writing.publish(2.5, timestamp=WALL + 1)))
    between.writing.now += away_s
    broker.core.poll(between.now)
    broker.core.connected(between.now)
    assert values(broker.passed_on()) == comes
    assert broker.core.take_drops().get(Drop.EXPIRED, 0) == (not comes)
