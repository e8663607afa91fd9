"""What becomes of a topic's messages: a mirrored UA topic, or a DataSet that `fleet.yaml` maps.

Each bridge calls it in the thread in which its ROS reads messages.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from ua_bridges.ros.fields import fields_of
from ua_bridges.ros.latched import mark_latched
from ua_bridges.ros.mapping import Follow, MappedSource
from ua_bridges.ros.serialized import MessageKind, flat_reader
from ua_bridges.ros.topic_mapping import TopicMapping
from ua_fleet.bridge.configured import ConfiguredData
from ua_fleet.bridge.driver import Dropped, Inlet, SampleRead, SourceFound, SourceLost
from ua_fleet.bridge.gate import RateGate
from ua_fleet.counters import Drop
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic

__all__ = ["Feed", "Mapped", "MappedFeed", "MirrorFeed", "Read"]

Read = Callable[[bytes, int, bool], None]
"""Hands on one serialized message: its time (ns since 1970), and whether this bridge had published it. It raises
ConversionError, or what the library raises."""
Mapped = ConfiguredData[TopicMapping]
"""A DataSet that is read from, or written to, a robot's own topic."""


class Feed(Protocol):
    """What is read from a topic: a DataSet, or a skill."""

    @property
    def topic(self) -> Topic | None:
        """The UA topic that it is read for; None for a skill, which keeps nothing of a time before."""
        ...

    @property
    def wanted_type(self) -> str | None:
        """The type that `fleet.yaml` gives the topic, `pkg/Name`; None where it is its publishers' to say."""
        ...

    def announce(self, kind: MessageKind, latched: bool) -> None:
        """Say that the source is there, with this message type. Raises UaFleetError where that has no fields."""
        ...

    def reader(self, kind: MessageKind) -> Read:
        """The function that hands on messages of this type."""
        ...

    def mistyped(self, ros_type: str, time_ns: int) -> None:
        """Say that the source is there with a type that is not the one of `fleet.yaml`."""
        ...

    def lost(self) -> None:
        """Say that the source is gone."""
        ...


class MirrorFeed:
    """A topic `ua_<space>_<ns>_<id>`: all that its messages hold, under the flat names of their fields."""

    wanted_type = None

    def __init__(self, topic: Topic, inlet: Inlet) -> None:
        self.topic = topic
        self._put = inlet.put

    def announce(self, kind: MessageKind, latched: bool) -> None:
        """See Feed."""
        schema = kind.schema
        fields = fields_of(schema, schema.name, kind.definition)
        fields = mark_latched(fields) if latched else fields
        self._put(SourceFound(self.topic, self.topic.name, fields, may_have_period=not latched))

    def reader(self, kind: MessageKind) -> Read:
        """See Feed."""
        values, topic, put = flat_reader(kind), self.topic, self._put

        def read(content: bytes, time_ns: int, own: bool) -> None:
            put(SampleRead(topic, values(content), time_ns, 0, own))

        return read

    def mistyped(self, ros_type: str, time_ns: int) -> None:
        """Nothing can be said of a source whose fields are unknown."""

    def lost(self) -> None:
        """See Feed."""
        self._put(SourceLost(self.topic))


class MappedFeed:
    """A DataSet of `fleet.yaml` that is picked out of a robot's own topic."""

    def __init__(self, data: Mapped, inlet: Inlet, loop: asyncio.AbstractEventLoop) -> None:
        """`loop` has the timer of its rate limit."""
        self.topic = data.topic
        self._name = data.side.topic
        self._mapped = MappedSource(data.config, data.name)
        self.wanted_type = self._mapped.message_type
        self._fields = tuple(make_field(name, builtin, array=array) for name, builtin, array in self._mapped.fields)
        self._put = inlet.put
        self._gate: RateGate[SampleRead] | None = None
        if data.side.max_rate_hz is not None:
            limited = Dropped(Drop.RATE_LIMITED)
            self._gate = RateGate(data.side.max_rate_hz, loop, inlet.put, lambda: inlet.put(limited))

    def announce(self, kind: MessageKind, latched: bool) -> None:
        """See Feed. The fields are those of `fleet.yaml`, whatever the robot publishes."""
        fields = mark_latched(self._fields) if latched else self._fields
        self._put(SourceFound(self.topic, self._name, fields, may_have_period=not latched))

    def reader(self, kind: MessageKind) -> Read:
        """See Feed."""
        flat, type_name = self._mapped.flat(kind.schema), kind.name
        opened = kind.message_reader() if flat is None else flat_reader(kind, flat.wanted)
        follow = None if flat is None else flat.follow

        def read(content: bytes, time_ns: int, own: bool) -> None:
            self._read(opened(content), type_name, time_ns, follow, own=own)

        return read

    def mistyped(self, ros_type: str, time_ns: int) -> None:
        """See Feed: every field is Bad, and says so once."""
        self._put(SourceFound(self.topic, self._name, self._fields))
        self._read(None, ros_type.replace("/msg/", "/"), time_ns)

    def _read(
        self, message: Any, type_name: str, time_ns: int, follow: Sequence[Follow] | None = None, *, own: bool = False
    ) -> None:
        values, problems = self._mapped.read(message, type_name, follow)
        if problems:
            told = "; ".join(f"{self._name} field {p.field}: {p.reason}" for p in problems if p.new)
            self._put(Dropped(Drop.CONVERSION, len(problems), told))
        sample = SampleRead(self.topic, values, time_ns, 0, own)
        if self._gate is None or own:  # what we had published ourselves must not push a robot's message out
            self._put(sample)
        else:
            self._gate.offer(sample)

    def lost(self) -> None:
        """See Feed. What waits for its turn goes first: nothing comes after it."""
        if self._gate is None:
            self._put(SourceLost(self.topic))
        else:
            self._gate.flush(lambda: self._put(SourceLost(self.topic)))
