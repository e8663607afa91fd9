# pyright: basic, reportMissingImports=false
"""What becomes of a ROS 2 topic's messages: a mirrored UA topic, or a DataSet that `fleet.yaml` maps.

All of it runs in the node's thread.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from ua_bridges.ros.fields import fields_of
from ua_bridges.ros.latched import mark_latched
from ua_bridges.ros.mapping import Follow, MappedSource
from ua_bridges.ros.topic_mapping import TopicMapping
from ua_bridges.ros2.classes import MessageType
from ua_bridges.ros2.serialized import flat_reader, message_reader
from ua_fleet.bridge.driver import Dropped, Inlet, SampleRead, SourceFound, SourceLost
from ua_fleet.config.schema import DataSetConfig
from ua_fleet.counters import Drop
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.rate import RateLimit
from ua_fleet.topics import Topic

__all__ = ["Feed", "MappedFeed", "MirrorFeed", "Read"]

Read = Callable[[bytes, int], None]
"""Hands on one serialized message with its time (ns since 1970); raises ConversionError."""


class Feed(Protocol):
    """A DataSet that is read from a topic."""

    @property
    def topic(self) -> Topic | None:
        """The UA topic that it is read for; None for a skill."""
        ...

    def found(self, kind: MessageType, latched: bool) -> None:
        """Say that the source is there, with this message type; raises SchemaInvalid where that has no fields."""
        ...

    def reader(self, kind: MessageType) -> Read:
        """The function that hands on messages of this type."""
        ...

    def mistyped(self, ros_type: str, time_ns: int) -> None:
        """Say that the source is there with a type that nobody can read here."""
        ...

    def release(self, now: float) -> float | None:
        """Hand on what has waited for its turn; when to ask again."""
        ...

    def lost(self) -> None:
        """Say that the source is gone."""
        ...


class MirrorFeed:
    """A topic `ua_<space>_<ns>_<id>`: all that its messages hold, under the flat names of their fields."""

    def __init__(self, topic: Topic, inlet: Inlet) -> None:
        self.topic = topic
        self._put = inlet.put

    def found(self, kind: MessageType, latched: bool) -> None:
        """See Feed."""
        fields = fields_of(kind.schema, kind.name)
        fields = mark_latched(fields) if latched else fields
        self._put(SourceFound(self.topic, self.topic.name, fields, may_have_period=not latched))

    def reader(self, kind: MessageType) -> Read:
        """See Feed."""
        values, topic, put = flat_reader(kind), self.topic, self._put

        def read(content: bytes, time_ns: int) -> None:
            put(SampleRead(topic, values(content), time_ns))

        return read

    def mistyped(self, ros_type: str, time_ns: int) -> None:
        """Nothing can be said of a source whose fields are unknown."""

    def release(self, now: float) -> float | None:
        """Nothing waits."""
        return None

    def lost(self) -> None:
        """See Feed."""
        self._put(SourceLost(self.topic))


class MappedFeed:
    """A DataSet of `fleet.yaml` that is picked out of a robot's own topic."""

    def __init__(
        self,
        topic: Topic,
        dataset: DataSetConfig,
        browse_name: str,
        inlet: Inlet,
        monotonic: Callable[[], float],
        wake_at: Callable[[float], None],
    ) -> None:
        """`wake_at` is told when `release` wants to be called."""
        assert isinstance(dataset.source, TopicMapping)
        self.topic = topic
        self._name = dataset.source.topic
        self._mapped = MappedSource(dataset, browse_name)
        self._fields = tuple(make_field(name, builtin, array=array) for name, builtin, array in self._mapped.fields)
        self._put = inlet.put
        self._monotonic, self._wake_at = monotonic, wake_at
        rate = dataset.source.max_rate_hz
        self._limit = RateLimit[SampleRead](rate) if rate is not None else None

    def found(self, kind: MessageType, latched: bool) -> None:
        """See Feed. The fields are those of `fleet.yaml`, whatever the robot publishes."""
        fields = mark_latched(self._fields) if latched else self._fields
        self._put(SourceFound(self.topic, self._name, fields, may_have_period=not latched))

    def reader(self, kind: MessageType) -> Read:
        """See Feed."""
        type_name, flat = kind.name, self._mapped.flat(kind.schema)
        if flat is None:
            message = message_reader(kind)
            return lambda content, time_ns: self._read(message(content), type_name, time_ns)
        values, follow = flat_reader(kind, flat.wanted), flat.follow
        return lambda content, time_ns: self._read(values(content), type_name, time_ns, follow)

    def mistyped(self, ros_type: str, time_ns: int) -> None:
        """See Feed: every field is Bad, and says so once."""
        self._put(SourceFound(self.topic, self._name, self._fields))
        self._read(None, ros_type.replace("/msg/", "/"), time_ns)

    def _read(self, message: Any, type_name: str, time_ns: int, follow: Sequence[Follow] | None = None) -> None:
        values, problems = self._mapped.read(message, type_name, follow)
        if problems:
            told = "; ".join(f"{self._name} field {p.field}: {p.reason}" for p in problems if p.new)
            self._put(Dropped(Drop.CONVERSION, len(problems), told))
        sample = SampleRead(self.topic, values, time_ns)
        if self._limit is None:
            self._put(sample)
            return
        passed, replaced = self._limit.offer(sample, self._monotonic())
        if replaced:
            self._put(Dropped(Drop.RATE_LIMITED))
        if passed is not None:
            self._put(passed)
        elif self._limit.due is not None:
            self._wake_at(self._limit.due)

    def release(self, now: float) -> float | None:
        """See Feed."""
        if self._limit is None:
            return None
        sample = self._limit.pop(now)
        if sample is not None:
            self._put(sample)
        return self._limit.due

    def lost(self) -> None:
        """See Feed. What waits for its turn goes first: nothing comes after it."""
        sample = self._limit.drain() if self._limit is not None else None
        if sample is not None:
            self._put(sample)
        self._put(SourceLost(self.topic))
