# pyright: basic, reportMissingImports=false
"""What becomes of a ROS 1 topic's messages: a mirrored UA topic, or a DataSet that `fleet.yaml` maps."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from struct import Struct
from struct import error as StructError  # noqa: N812 - its name says nothing
from typing import Any, Final, Protocol

from ua_bridges.ros.codec import Decoder, compile_decoder
from ua_bridges.ros.convert import compile_reader
from ua_bridges.ros.errors import Unreadable
from ua_bridges.ros.fields import fields_of
from ua_bridges.ros.latched import mark_latched
from ua_bridges.ros.mapping import MappedSource
from ua_bridges.ros.schema import MessageSchema, ros1_type_name, schema_from_definition
from ua_bridges.ros.stamp import source_time_ns
from ua_bridges.ros.topic_mapping import TopicMapping
from ua_bridges.ros1.classes import MessageType
from ua_fleet.bridge.driver import Dropped, Inlet, SampleRead, SourceFound, SourceLost
from ua_fleet.bridge.gate import RateGate
from ua_fleet.config.schema import DataSetConfig
from ua_fleet.counters import Drop
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic

__all__ = ["Feed", "MappedFeed", "MirrorFeed", "Read", "flat_reader", "message_reader", "schema_of"]

_STAMP: Final = Struct("<4xII")
"""Behind the Header's seq."""

Read = Callable[[bytes, int, bool], None]
"""Hands on one serialized message; its time of arrival (ns since 1970), and whether this bridge had published it."""


class Feed(Protocol):
    """What is read from a topic: a DataSet, or a skill. `announce`, the readers and `lost` may run in any thread."""

    @property
    def topic(self) -> Topic | None:
        """The UA topic that it is read for; None for a skill, which keeps nothing of a time before."""
        ...

    @property
    def wanted_type(self) -> str | None:
        """The type that `fleet.yaml` gives the topic, `pkg/Name`; None where it is its publishers' to say."""
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


def message_reader(kind: MessageType) -> Callable[[bytes], Any]:
    """A function that makes a message object; it raises what genpy raises."""
    return lambda content: kind.cls().deserialize(content)


def flat_reader(kind: MessageType, wanted: frozenset[str] | None = None) -> Decoder:
    """A function from a message's bytes to the values of its flat fields, or those of them that are wanted."""
    schema = schema_of(kind)
    decode, values = compile_decoder(schema, wanted, packed_arrays=True), compile_reader(schema)
    message = message_reader(kind)
    return decode or (lambda content: values(message(content)))


def _stamp_reader(kind: MessageType) -> Callable[[bytes], int] | None:
    """Reads the stamp of the Header at the type's top level, ns since 1970; None where there is none."""
    types = list(kind.cls._slot_types)  # noqa: SLF001 - genpy's name for it
    if "std_msgs/Header" not in types:
        return None
    name, is_first = kind.cls.__slots__[types.index("std_msgs/Header")], types[0] == "std_msgs/Header"
    message = message_reader(kind)

    def read(content: bytes) -> int:
        if is_first:
            try:
                seconds, nanoseconds = _STAMP.unpack_from(content)
            except StructError as error:
                raise Unreadable(kind.name, str(error)) from error
        else:
            stamp = getattr(message(content), name).stamp
            seconds, nanoseconds = stamp.secs, stamp.nsecs
        return int(seconds * 1_000_000_000 + nanoseconds)

    return read


def schema_of(kind: MessageType) -> MessageSchema:
    """The schema of a message type."""
    return schema_from_definition(kind.name, kind.definition)


class MirrorFeed:
    """A topic `ua_<space>_<ns>_<id>`: all that its messages hold, under the flat names of their fields."""

    wanted_type = None

    def __init__(self, topic: Topic, inlet: Inlet) -> None:
        self.topic = topic
        self._inlet = inlet

    def announce(self, kind: MessageType, latched: bool) -> None:
        """See Feed."""
        schema = schema_of(kind)
        fields = fields_of(schema, schema.name, kind.definition)
        fields = mark_latched(fields) if latched else fields
        self._inlet.put(SourceFound(self.topic, self.topic.name, fields, may_have_period=not latched))

    def reader(self, kind: MessageType) -> Read:
        """See Feed."""
        values, stamp, topic, put = flat_reader(kind), _stamp_reader(kind), self.topic, self._inlet.put
        if stamp is None:

            def read(content: bytes, received_ns: int, own: bool) -> None:
                put(SampleRead(topic, values(content), received_ns, 0, own))

            return read

        def read_stamped(content: bytes, received_ns: int, own: bool) -> None:
            put(SampleRead(topic, values(content), source_time_ns(stamp(content), received_ns), 0, own))

        return read_stamped

    def lost(self) -> None:
        """See Feed."""
        self._inlet.put(SourceLost(self.topic))


class MappedFeed:
    """A DataSet of `fleet.yaml` that is picked out of a robot's own topic."""

    def __init__(
        self, topic: Topic, dataset: DataSetConfig, browse_name: str, inlet: Inlet, loop: asyncio.AbstractEventLoop
    ) -> None:
        assert isinstance(dataset.source, TopicMapping)
        self.topic = topic
        self._name = dataset.source.topic
        self.wanted_type = ros1_type_name(dataset.source.message_type)
        self._mapped = MappedSource(dataset, browse_name)
        self._fields = tuple(make_field(name, builtin, array=array) for name, builtin, array in self._mapped.fields)
        self._put = inlet.put
        self._gate: RateGate[SampleRead] | None = None
        if dataset.source.max_rate_hz is not None:
            self._gate = RateGate(
                dataset.source.max_rate_hz, loop, inlet.put, lambda: inlet.put(Dropped(Drop.RATE_LIMITED))
            )

    def announce(self, kind: MessageType, latched: bool) -> None:
        """See Feed. The fields are those of `fleet.yaml`, whatever the robot publishes."""
        self._put(SourceFound(self.topic, self._name, self._fields, may_have_period=not latched))

    def reader(self, kind: MessageType) -> Read:
        """See Feed."""
        read_fields, stamp, type_name = self._mapped.read, _stamp_reader(kind), kind.name
        flat = self._mapped.flat(schema_of(kind))
        message = message_reader(kind) if flat is None else flat_reader(kind, flat.wanted)
        follow = None if flat is None else flat.follow

        def read(content: bytes, received_ns: int, own: bool) -> None:
            values, problems = read_fields(message(content), type_name, follow)
            if problems:
                told = "; ".join(f"{self._name} field {p.field}: {p.reason}" for p in problems if p.new)
                self._put(Dropped(Drop.CONVERSION, len(problems), told))
            time_ns = received_ns if stamp is None else source_time_ns(stamp(content), received_ns)
            sample = SampleRead(self.topic, values, time_ns, 0, own)
            if self._gate is None or own:  # what we had published ourselves must not push a robot's message out
                self._put(sample)
            else:
                self._gate.offer(sample)

        return read

    def lost(self) -> None:
        """See Feed. What waits for its turn goes first."""
        if self._gate is None:
            self._put(SourceLost(self.topic))
        else:
            self._gate.flush(lambda: self._put(SourceLost(self.topic)))
