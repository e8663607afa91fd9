# pyright: basic, reportMissingImports=false
"""What becomes of a ROS 1 topic's messages: a mirrored UA topic, or a DataSet that `fleet.yaml` maps."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

from ua_bridges.ros.convert import compile_reader
from ua_bridges.ros.fields import fields_of
from ua_bridges.ros.latched import mark_latched
from ua_bridges.ros.mapping import MappedSource
from ua_bridges.ros.schema import MessageSchema, schema_from_definition
from ua_bridges.ros.stamp import source_time_ns
from ua_bridges.ros1.classes import MessageType
from ua_fleet.bridge.driver import Dropped, Inlet, SampleRead, SourceFound, SourceLost
from ua_fleet.bridge.rate import RateGate
from ua_fleet.config.schema import DataSetConfig
from ua_fleet.counters import Drop
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic

__all__ = ["Feed", "MappedFeed", "MirrorFeed", "Read", "schema_of"]

Read = Callable[[Any, int, bool], None]
"""Hands on one message object; its time of arrival (ns since 1970), and whether this bridge had published it."""


class Feed(Protocol):
    """What is read from a topic: a DataSet, or a skill. `announce`, the readers and `lost` may run in any thread."""

    @property
    def topic(self) -> Topic | None:
        """The UA topic that it is read for; None for a skill, which keeps nothing of a time before."""
        ...

    def announce(self, kind: MessageType, latched: bool) -> None:
        """Say that the source is there, with this message type. Raises UaFleetError where that has no fields."""
        ...

    def reader(self, kind: MessageType) -> Read:
        """The function that hands on messages of this type; it raises ConversionError."""
        ...

    def lost(self) -> None:
        """Say that the source is gone."""
        ...


def _stamp_reader(kind: MessageType) -> Callable[[Any], int] | None:
    """Reads the stamp of the Header at the type's top level, ns since 1970; None where there is none."""
    slots = zip(kind.cls.__slots__, kind.cls._slot_types, strict=True)  # noqa: SLF001 - genpy's name for it
    name = next((name for name, slot_type in slots if slot_type == "std_msgs/Header"), None)
    if name is None:
        return None

    def read(message: Any) -> int:
        stamp = getattr(message, name).stamp
        return int(stamp.secs) * 1_000_000_000 + int(stamp.nsecs)

    return read


def schema_of(kind: MessageType) -> MessageSchema:
    """The schema of a message type."""
    return schema_from_definition(kind.name, kind.definition)


class MirrorFeed:
    """A topic `ua_<space>_<ns>_<id>`: all that its messages hold, under the flat names of their fields."""

    def __init__(self, topic: Topic, inlet: Inlet) -> None:
        self.topic = topic
        self._inlet = inlet

    def announce(self, kind: MessageType, latched: bool) -> None:
        """See Feed."""
        schema = schema_of(kind)
        fields = fields_of(schema, schema.name, kind.definition)
        self._inlet.put(SourceFound(self.topic, self.topic.name, mark_latched(fields) if latched else fields))

    def reader(self, kind: MessageType) -> Read:
        """See Feed."""
        values, stamp, topic, put = compile_reader(schema_of(kind)), _stamp_reader(kind), self.topic, self._inlet.put
        if stamp is None:

            def read(message: Any, received_ns: int, own: bool) -> None:
                put(SampleRead(topic, values(message), received_ns, 0, own))

            return read

        def read_stamped(message: Any, received_ns: int, own: bool) -> None:
            put(SampleRead(topic, values(message), source_time_ns(stamp(message), received_ns), 0, own))

        return read_stamped

    def lost(self) -> None:
        """See Feed."""
        self._inlet.put(SourceLost(self.topic))


class MappedFeed:
    """A DataSet of `fleet.yaml` that is picked out of a robot's own topic."""

    def __init__(
        self, topic: Topic, dataset: DataSetConfig, browse_name: str, inlet: Inlet, loop: asyncio.AbstractEventLoop
    ) -> None:
        assert dataset.source_topic is not None
        self.topic = topic
        self._name = dataset.source_topic.topic
        self._mapped = MappedSource(dataset, browse_name)
        self._fields = tuple(make_field(name, builtin, array=array) for name, builtin, array in self._mapped.fields)
        self._put = inlet.put
        self._loop = loop
        self._gate: RateGate[SampleRead] | None = None
        if dataset.source_topic.max_rate_hz is not None:
            self._gate = RateGate(
                dataset.source_topic.max_rate_hz, loop, inlet.put, lambda: inlet.put(Dropped(Drop.RATE_LIMITED))
            )

    def announce(self, kind: MessageType, latched: bool) -> None:
        """See Feed. The fields are those of `fleet.yaml`, whatever the robot publishes."""
        self._in_order(self._put, SourceFound(self.topic, self._name, self._fields))

    def reader(self, kind: MessageType) -> Read:
        """See Feed."""
        read_fields, stamp, type_name = self._mapped.read, _stamp_reader(kind), kind.name

        def read(message: Any, received_ns: int, own: bool) -> None:
            values, problems = read_fields(message, type_name)
            if problems:
                told = "; ".join(f"{self._name} field {p.field}: {p.reason}" for p in problems if p.new)
                self._put(Dropped(Drop.CONVERSION, len(problems), told))
            time_ns = received_ns if stamp is None else source_time_ns(stamp(message), received_ns)
            sample = SampleRead(self.topic, values, time_ns, 0, own)
            if self._gate is None or own:  # what we had published ourselves must not push a robot's message out
                self._put(sample)
            else:
                self._in_order(self._gate.offer, sample)

        return read

    def lost(self) -> None:
        """See Feed. What waits for its turn goes first."""
        if self._gate is not None:
            self._in_order(lambda _: self._gate.flush() if self._gate else None, None)
        self._in_order(self._put, SourceLost(self.topic))

    def _in_order(self, hand_on: Callable[[Any], object], item: Any) -> None:
        """With a rate limit all goes through the event loop, where its timer runs, so that the order stays."""
        if self._gate is None:
            hand_on(item)
        else:
            self._loop.call_soon_threadsafe(hand_on, item)
