"""A publisher and a subscriber with a hand-moved clock, for the tests of this folder."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from random import Random
from typing import Any, TypeVar

from ua_fleet.counters import Counters
from ua_fleet.pubsub import Publisher, PubSubTiming, Subscriber, SubscriberEvent, make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import DataSetMessage, MetaDataAnnouncement, NetworkMessage

WALL = 134_000_000_000_000_000
"""A time in 2025, in ticks."""
TOPIC = Topic(1, 2, 1001)
FIELDS = (make_field("level", BuiltinType.DOUBLE), make_field("name", BuiltinType.STRING))
CODEC = Codec()

Event = TypeVar("Event")


def only(kind: type[Event], events: Iterable[SubscriberEvent]) -> list[Event]:
    return [event for event in events if isinstance(event, kind)]


def decoded(datagrams: Iterable[bytes]) -> list[Any]:
    return [CODEC.decode(datagram) for datagram in datagrams]


def messages(datagrams: Iterable[bytes]) -> list[DataSetMessage]:
    """The DataSetMessages of datagrams, in order."""
    return [part for message in decoded(datagrams) if isinstance(message, NetworkMessage) for part in message.messages]


def announcements(datagrams: Iterable[bytes]) -> list[MetaDataAnnouncement]:
    return [message for message in decoded(datagrams) if isinstance(message, MetaDataAnnouncement)]


@dataclass
class Writing:
    """A publisher in space 1 with one announced writer."""

    timing: PubSubTiming = field(default_factory=PubSubTiming)
    counters: Counters = field(default_factory=Counters)
    now: float = 100.0

    def __post_init__(self) -> None:
        self.publisher = Publisher(TOPIC.space, self.timing, self.counters, CODEC)

    def announce(self, topic: Topic = TOPIC, **changes: Any) -> list[bytes]:
        arguments: dict[str, Any] = {"name": "arm", "fields": FIELDS, "wall_ticks": WALL, **changes}
        return self.publisher.announce(topic, now=self.now, **arguments)

    def publish(
        self, level: float = 1.0, *, topic: Topic = TOPIC, timestamp: int = WALL, status: int = 0
    ) -> list[bytes]:
        return self.publisher.publish(topic, (level, "a"), timestamp=timestamp, status=status, now=self.now)

    def run_until(self, end: float) -> list[tuple[float, list[bytes]]]:
        """Poll at each deadline until `end`; the times at which something was sent, with the datagrams."""
        sent: list[tuple[float, list[bytes]]] = []
        while (due := self.publisher.next_deadline()) is not None and due <= end:
            self.now = max(self.now, due)
            if datagrams := self.publisher.poll(self.now):
                sent.append((self.now, datagrams))
        self.now = end
        return sent


@dataclass
class Reading:
    """A subscriber of the server (space 0)."""

    timing: PubSubTiming = field(default_factory=PubSubTiming)
    counters: Counters = field(default_factory=Counters)
    own_space: int = 0
    max_writers: int = 1000

    def __post_init__(self) -> None:
        self.subscriber = Subscriber(
            self.own_space, self.timing, self.counters, CODEC, max_writers=self.max_writers, random=Random(1)
        )

    def receive(self, datagrams: Iterable[bytes], now: float) -> list[SubscriberEvent]:
        return [event for datagram in datagrams for event in self.subscriber.receive(datagram, now)]

    def run_until(self, end: float) -> list[tuple[float, SubscriberEvent]]:
        """Poll at each deadline until `end`; the facts with their times."""
        events: list[tuple[float, SubscriberEvent]] = []
        while (due := self.subscriber.next_deadline()) is not None and due <= end:
            events += [(due, event) for event in self.subscriber.poll(due)]
        return events
