"""What a subscriber of that time was told: the facts of a recording, in order.

And the same as those of another space, to be published again: nothing of it can be taken for live.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from ua_fleet.counters import Counters
from ua_fleet.errors import LocalWireError
from ua_fleet.pubsub.events import DataReceived, MetaDataReceived, SourceReturned, SourceSilent, SubscriberEvent
from ua_fleet.pubsub.metadata import NODE_ONLY
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import LoopVerdict, Side, Topic
from ua_fleet.values import BuiltinType, QualifiedName, StatusCode
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import DataSetMessage, FieldMetaData

__all__ = ["NOBODY", "REPLAY_SPACE", "Playback", "Replay"]

NOBODY: Final = -1
"""Who only looks stands in no space."""
REPLAY_SPACE: Final = 65_535
"""The origin of replayed values, unless another one is named."""
_SUBSTITUTE: Final = int(StatusCode.UNCERTAIN_SUBSTITUTE_VALUE)
_BAD: Final = int(StatusCode.BAD)
_STATUS_CODE: Final = int(BuiltinType.STATUS_CODE)


def _hear_all(_side: Side, _origin: int, _own_space: int, _own_publication: bool) -> LoopVerdict:
    return LoopVerdict.TO_SPACE


class Playback:
    """A subscriber in the time of the recording."""

    def __init__(
        self, counters: Counters, timing: PubSubTiming | None = None, setpoint_groups: Mapping[int, int] | None = None
    ) -> None:
        """Make one that has heard nothing; `setpoint_groups` are left out."""
        self._subscriber = Subscriber(
            NOBODY, timing or PubSubTiming(), counters, Codec(), _hear_all, setpoint_groups=setpoint_groups
        )
        self._now = 0.0

    def feed(self, plain: bytes | None, now: float, *, is_fresh: bool = True) -> list[SubscriberEvent]:
        """What a message told, after what the time before it had told; None is time alone.

        `is_fresh` as in Subscriber.receive.
        """
        self._now = max(self._now, now)  # a wall clock that was set back
        events: list[SubscriberEvent] = []
        while (due := self._subscriber.next_deadline()) is not None and due <= self._now:
            events += self._subscriber.poll(due)
        if plain is not None:
            events += self._subscriber.receive(plain, self._now, is_fresh=is_fresh)
        return events


class Replay:
    """Publishes what a recording tells as data of a space of its own."""

    def __init__(
        self,
        publisher: Publisher,
        space: int,
        only: Callable[[Topic], bool] = lambda _: True,
        namespace: int | None = None,
    ) -> None:
        """Make a replay.

        Args:
            publisher: of that space.
            space: the origin of what is published.
            only: which recorded sources are published.
            namespace: index of the namespace that all ids are in; None leaves each where it was.
        """
        self._publisher, self._space, self._only, self._namespace = publisher, space, only, namespace
        self._topics: dict[Topic, Topic] = {}
        self.values = 0
        """Values that were published."""
        self.refused = 0
        """Values that could not be published."""

    @property
    def topics(self) -> Mapping[Topic, Topic]:
        """The recorded sources that were published, and what they are now."""
        return self._topics

    def take(self, fact: SubscriberEvent, *, now: float, wall_ticks: int) -> list[bytes]:
        """The datagrams to send for a fact of the recording.

        An event is not told again: it would be another one.
        """
        if not isinstance(fact, DataReceived | MetaDataReceived | SourceSilent | SourceReturned):
            return []
        if not self._only(fact.topic):
            return []
        topic = Topic(self._space, self._namespace or fact.topic.ns, fact.topic.id)
        try:
            if isinstance(fact, MetaDataReceived):
                self._topics[fact.topic] = topic
                name, fields = fact.metadata.name, _of_nodes_alone(fact.metadata.fields)
                return self._publisher.announce(topic, name, fields, now=now, wall_ticks=wall_ticks)
            if isinstance(fact, DataReceived):
                types, values = _with_bad_fields(fact.message)
                status = fact.message.status or 0
                self.values += 1
                return self._publisher.publish(
                    topic,
                    values,
                    timestamp=wall_ticks if fact.message.timestamp is None else fact.message.timestamp,
                    status=status if status & _BAD else _SUBSTITUTE,
                    now=now,
                    types=types,
                )
            if isinstance(fact, SourceSilent) and fact.topic in self._topics:
                return self._publisher.source_lost(topic, timestamp=0, now=now)
        except LocalWireError:
            self.refused += 1
        return []

    def end(self, now: float) -> list[bytes]:
        """All sources are gone, and so is their publisher."""
        lost = [self._publisher.source_lost(topic, timestamp=0, now=now) for topic in self._topics.values()]
        return [datagram for datagrams in lost for datagram in datagrams] + self._publisher.end()


def _of_nodes_alone(fields: tuple[FieldMetaData, ...]) -> tuple[FieldMetaData, ...]:
    """Fields that bridges keep out of their spaces, and that announce no robot, no type and no age."""
    bare = [field._replace(properties=()) for field in fields]
    if bare:
        node_only = (QualifiedName(0, NODE_ONLY), int(BuiltinType.BOOLEAN), True)
        bare[0] = bare[0]._replace(properties=(node_only,))
    return tuple(bare)


def _with_bad_fields(message: DataSetMessage) -> tuple[tuple[int, ...], tuple[Any, ...]]:
    """Types and values with a StatusCode in place of each field that is Bad by itself."""
    if message.field_status is None:
        return message.types, message.values
    bad = [status if status & _BAD else None for status in message.field_status]
    types = tuple([code if one is None else _STATUS_CODE for one, code in zip(bad, message.types, strict=True)])
    values = tuple([value if one is None else one for one, value in zip(bad, message.values, strict=True)])
    return types, values
