# pyright: basic, reportMissingImports=false
"""All that the bridge publishes into the ROS 1 graph: mirrored topics of other spaces, and the sinks of `fleet.yaml`.

Used in the event loop. The watch only reads which outlets there are.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import rospy

from ua_bridges.ros.delivered import Delivered
from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.fields import is_same_type
from ua_bridges.ros.form import Form, form_of, with_stamp
from ua_bridges.ros.latched import is_latched
from ua_bridges.ros.schema import ros1_type_name
from ua_bridges.ros.topic_mapping import TopicMapping
from ua_bridges.ros1.classes import MessageType, installed_type, needed_type, type_from_definition
from ua_bridges.ros1.outlet import QUEUE_SIZE, Outlet
from ua_fleet.bridge.driver import Dropped, Inlet
from ua_fleet.bridge.gate import RateGate
from ua_fleet.config.schema import DataSetConfig
from ua_fleet.counters import Drop
from ua_fleet.errors import ConfigError, FieldMissing, UaFleetError
from ua_fleet.fleet.matching import FieldOrder
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["Outlets"]

MAX_MIRRORED: Final = 2000
"""Topics of other spaces that are published here; each costs a registration, and anybody may send new ones."""

_Values = tuple[Any, ...]


class _Mirrored(NamedTuple):
    """A topic of another space, and the metadata that its outlet was made for."""

    metadata: DataSetMetaData
    outlet: Outlet | Dropped
    """Or why there is none."""
    form: Form | None = None


class _Sink(NamedTuple):
    """A robot's own topic that a DataSet of the server is written to."""

    outlet: Outlet | Dropped
    order: FieldOrder
    gate: RateGate[_Values] | None


class Outlets:
    """The publishers of the bridge, by the DataSet that they publish."""

    def __init__(
        self,
        inlet: Inlet,
        loop: asyncio.AbstractEventLoop,
        delivered: Delivered,
        changed: Callable[[Outlet | None], None],
        named: Mapping[Topic, str] | None = None,
    ) -> None:
        """Begin without outlets.

        Args:
            inlet: where drops are told.
            loop: for the timers of rate limits.
            delivered: what the bridge before this one had published.
            changed: told when an outlet is made, and with the old one when it takes the place of another.
            named: see `ros.form.named_types`.
        """
        self._named = named or {}
        self._inlet, self._loop, self._delivered, self._changed = inlet, loop, delivered, changed
        self._started: set[Topic] = set()
        """The topics of which this process has published anything."""
        self._mirrored: dict[Topic, _Mirrored] = {}
        self._sinks: dict[Topic, list[_Sink]] = {}
        self._shared: dict[str, tuple[MessageType, Any]] = {}
        """The message that the sinks of one topic share."""

    def __iter__(self) -> Iterator[Outlet]:
        """All outlets that there are now; callable from any thread."""
        outlets = [mirrored.outlet for mirrored in list(self._mirrored.values())]
        outlets += [sink.outlet for sinks in list(self._sinks.values()) for sink in sinks]
        return iter([outlet for outlet in outlets if isinstance(outlet, Outlet)])

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """Publish a message on all topics that it belongs to; whether it went out on any."""
        mirrored = self._mirrored.get(topic)
        if mirrored is None or not is_same_type(mirrored.metadata, metadata):
            mirrored = self._mirror(topic, metadata, mirrored)
        elif mirrored.metadata is not metadata:
            mirrored = self._mirrored[topic] = mirrored._replace(metadata=metadata)
        sinks = self._sinks.get(topic, ())
        if topic not in self._started:
            if self._delivered.is_known(topic, message.timestamp):
                self._remember(mirrored, sinks, metadata, message)
                return False
            self._started.add(topic)
        sent = False
        if not (sinks and isinstance(mirrored.outlet, Dropped)):  # what reaches its sink needs no form as a UA topic
            sent = self._send(mirrored.outlet, () if mirrored.form is None else mirrored.form.values(message))
        for sink in sinks:
            try:
                values = sink.order.arranged(metadata, message.values)
            except FieldMissing as error:
                self._inlet.put(Dropped(Drop.CONVERSION, detail=str(error)))
                continue
            if sink.gate is None:
                sent = self._send(sink.outlet, values) or sent
            else:
                sink.gate.offer(values)
                sent = True
        if sent:
            self._delivered.note(topic, message.timestamp)
        return sent

    def _remember(
        self, mirrored: _Mirrored, sinks: Sequence[_Sink], metadata: DataSetMetaData, message: DataSetMessage
    ) -> None:
        """Only late subscribers get a message that the bridge before this one had published."""
        self._inlet.put(Dropped(Drop.REPEATED))
        values = message.values
        with contextlib.suppress(ConversionError):  # it could not be published before either
            if isinstance(mirrored.outlet, Outlet) and mirrored.form is not None:
                mirrored.outlet.remember(mirrored.form.values(message))
        for sink in sinks:
            if isinstance(sink.outlet, Outlet):
                with contextlib.suppress(ConversionError, FieldMissing):
                    sink.outlet.remember(sink.order.arranged(metadata, values))

    def setpoint_problem(self, topic: Topic) -> str:
        """See Driver."""
        for sink in self._sinks.get(topic, ()):
            if isinstance(sink.outlet, Dropped):
                return sink.outlet.detail
            if not sink.outlet.listeners:
                return f"{sink.outlet.name} has no subscriber in ROS"
        return ""

    def write_setpoint(self, topic: Topic, values: _Values) -> None:
        """See Driver."""
        for sink in self._sinks.get(topic, ()):
            if isinstance(sink.outlet, Dropped):
                self._inlet.put(sink.outlet)
                continue
            try:
                is_written = sink.outlet.write(values)
            except (ConversionError, rospy.ROSException, rospy.ROSSerializationException) as error:
                self._inlet.put(Dropped(Drop.CONVERSION, detail=f"{sink.outlet.name}: {error}"))
            else:
                if not is_written:
                    self._inlet.put(Dropped(Drop.NOT_CONNECTED))

    def add_sink(
        self,
        topic: Topic,
        browse_name: str,
        dataset: DataSetConfig,
        order: FieldOrder,
        *,
        takes_setpoints: bool = False,
    ) -> None:
        """Write the DataSet to the robot's own topic, too; `order` puts its values into that of `fleet.yaml`.

        What takes setpoints keeps one for a slow subscriber, the latest.
        """
        mapping = dataset.sink
        assert isinstance(mapping, TopicMapping)
        paths = [field.path or name or "data" for name, field in dataset.all_fields().items()]
        outlet: Outlet | Dropped
        try:
            outlet = self._sink_outlet(mapping, paths, 1 if takes_setpoints else QUEUE_SIZE)
        except UaFleetError as error:
            outlet = Dropped(Drop.TYPE_MISSING, detail=f"{browse_name} cannot be written to {mapping.topic}: {error}")
        gate = None
        if mapping.max_rate_hz is not None and isinstance(outlet, Outlet):
            gate = self._gate(mapping.max_rate_hz, outlet)
        self._sinks.setdefault(topic, []).append(_Sink(outlet, order, gate))

    def close(self) -> None:
        """Stop all timers."""
        for sinks in self._sinks.values():
            for sink in sinks:
                if sink.gate is not None:
                    sink.gate.close()

    def _send(self, outlet: Outlet | Dropped, values: _Values) -> bool:
        if isinstance(outlet, Dropped):
            self._inlet.put(outlet)
            return False
        try:
            self._count_lost(outlet, outlet.publish(values))
        except (ConversionError, rospy.ROSException, rospy.ROSSerializationException) as error:
            self._inlet.put(Dropped(Drop.CONVERSION, detail=f"{outlet.name}: {error}"))
            return False
        return True

    def _count_lost(self, outlet: Outlet, lost: int) -> None:
        """Messages that were held for subscribers that are still connecting, and are not held any more."""
        if lost:
            self._inlet.put(Dropped(Drop.INLET_FULL, lost, f"{outlet.name}: more messages than are held at its start"))

    def _mirror(self, topic: Topic, metadata: DataSetMetaData, before: _Mirrored | None) -> _Mirrored:
        if before is None and len(self._mirrored) >= MAX_MIRRORED:
            return _Mirrored(
                metadata, Dropped(Drop.UNKNOWN_SOURCE, detail=f"more than {MAX_MIRRORED} topics of other spaces")
            )
        replaced = before.outlet if before is not None and isinstance(before.outlet, Outlet) else None
        if replaced is not None:
            self._count_lost(replaced, replaced.close())
        outlet: Outlet | Dropped
        form: Form | None = None
        try:
            kind, form = _type_for(topic, metadata, {} if topic in self._sinks else self._named)
            # A Variable of the server is a state; a robot's message is an event unless the robot says otherwise.
            latched = topic.space == SERVER_SPACE or is_latched(metadata.fields)
            shared = None if form.is_whole else kind.cls()
            outlet = Outlet(f"/{topic.name}", kind, form.names, latched=latched, shared=shared)
        except UaFleetError as error:
            outlet = Dropped(Drop.TYPE_MISSING, detail=f"{topic.name} cannot be published here: {error}")
        self._mirrored[topic] = mirrored = _Mirrored(metadata, outlet, form)
        self._changed(replaced)
        return mirrored

    def _sink_outlet(self, mapping: TopicMapping, paths: list[str], queue_size: int) -> Outlet:
        name = mapping.own_topic
        kind = needed_type(ros1_type_name(mapping.message_type))
        shared_kind, shared = self._shared.setdefault(name, (kind, kind.cls()))
        if shared_kind.name != kind.name:
            raise ConfigError(f"another sink has the type {shared_kind.name} for this topic, not {kind.name}")
        return Outlet(name, kind, paths, latched=mapping.latched, shared=shared, queue_size=queue_size)

    def _gate(self, rate_hz: float, outlet: Outlet) -> RateGate[_Values]:
        def replaced() -> None:
            self._inlet.put(Dropped(Drop.RATE_LIMITED))

        def deliver(values: _Values) -> None:
            self._send(outlet, values)

        return RateGate(rate_hz, self._loop, deliver, replaced)


def _type_for(topic: Topic, metadata: DataSetMetaData, named: Mapping[Topic, str]) -> tuple[MessageType, Form]:
    """The type to publish a DataSet with, and how its values go into it; raises UaFleetError."""
    form = form_of(topic, metadata, named)
    type_name = ros1_type_name(form.ros_type)
    if installed_type(type_name) is None and form.definition is not None:
        return type_from_definition(type_name, form.definition), form
    kind = needed_type(type_name)
    return kind, with_stamp(form, kind.schema)
