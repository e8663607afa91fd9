"""All that a bridge publishes into its graph: mirrored topics of other spaces, and the sinks of `fleet.yaml`.

    message -> form of the topic      -> mirrored outlet -> /ua_<space>_<ns>_<id>
            -> fields in their order  -> rate limit      -> outlet of a robot's own topic

Which bytes go to whom is the library's affair, behind `Outlet` and `Publishing`. Used in the event loop.
"""

from __future__ import annotations

import asyncio
import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

from ua_bridges.ros.delivered import Delivered, OnItsWay
from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.feed import Mapped
from ua_bridges.ros.fields import is_same_type
from ua_bridges.ros.form import Form, form_of
from ua_bridges.ros.latched import is_latched
from ua_fleet.bridge.driver import Dropped, Inlet
from ua_fleet.bridge.gate import RateGate
from ua_fleet.counters import Drop
from ua_fleet.errors import FieldMissing, UaFleetError
from ua_fleet.fleet.matching import FieldOrder
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData, FrameKind

__all__ = ["MAX_MIRRORED", "Gone", "Outlet", "Outlets", "Publishing", "Values"]

MAX_MIRRORED: Final = 2000
"""Topics of other spaces that are published here; each costs a publisher, and anybody may send new ones."""

Values = tuple[Any, ...]
Gone = Callable[[], None]
"""Told that a message has been published; callable from any thread."""


class Outlet(Protocol):
    """A topic that the bridge publishes, with the conversion of one DataSet. All raise ConversionError."""

    name: str
    """Full name of the topic."""

    def publish(self, values: Values, gone: Gone) -> int:
        """Publish one message, or hold it until the subscribers are there; how many held ones went for it.

        `gone` is called when it is published, and never for one that is held to the end.
        """
        ...

    def write(self, values: Values) -> bool:
        """Publish one message now, or not at all, since it would be worthless later; whether it went out."""
        ...

    @property
    def listeners(self) -> int:
        """How many subscribers get what is written now."""
        ...

    def remember(self, values: Values) -> None:
        """Keep a message that the bridge before this one has published, for those subscribers that it is owed to."""
        ...

    def supersede(self) -> None:
        """There is a newer message than the one that is kept."""
        ...


AnyOutlet = TypeVar("AnyOutlet", bound=Outlet)


class Publishing(ABC, Generic[AnyOutlet]):
    """How a bridge publishes in its ROS."""

    failures: tuple[type[Exception], ...] = (ConversionError,)
    """What an outlet raises when a message cannot be published; a library may have errors of its own."""

    @abstractmethod
    def mirror(self, name: str, form: Form, *, latched: bool, are_events: bool) -> tuple[AnyOutlet, Form]:
        """The outlet of a topic of another space, and the form that the type here has; raises UaFleetError.

        Events are never latched, and of a burst none may be lost to a subscriber that is there.
        """

    @abstractmethod
    def sink(self, data: Mapped, *, takes_setpoints: bool) -> AnyOutlet:
        """The outlet of a robot's own topic; raises UaFleetError.

        What takes setpoints keeps one for a slow subscriber, the latest.
        """

    @abstractmethod
    def retire(self, outlet: AnyOutlet) -> int:
        """An outlet will be replaced; how many messages it held that go with it."""

    @abstractmethod
    def changed(self, made: AnyOutlet | None, replaced: AnyOutlet | None) -> None:
        """An outlet is there, or is not since there is no type for it, in place of another."""


class _Mirrored(NamedTuple, Generic[AnyOutlet]):
    """A topic of another space, and the metadata that its outlet was made for."""

    metadata: DataSetMetaData
    outlet: AnyOutlet | Dropped
    """Or why there is none."""
    form: Form | None = None


class _Sink(NamedTuple, Generic[AnyOutlet]):
    """A robot's own topic that a DataSet of the server is written to."""

    outlet: AnyOutlet | Dropped
    order: FieldOrder
    gate: RateGate[tuple[Values, OnItsWay]] | None


class Outlets(Generic[AnyOutlet]):
    """The publishers of the bridge, by the DataSet that they publish."""

    def __init__(
        self,
        inlet: Inlet,
        loop: asyncio.AbstractEventLoop,
        delivered: Delivered,
        publishing: Publishing[AnyOutlet],
        named: Mapping[Topic, str] | None = None,
    ) -> None:
        """Begin without outlets.

        Args:
            inlet: where drops are told.
            loop: for the timers of rate limits.
            delivered: what the bridge before this one had published.
            publishing: makes the outlets.
            named: see `ros.form.named_types`.
        """
        self._inlet, self._loop, self._delivered, self._publishing = inlet, loop, delivered, publishing
        self._named = named or {}
        self._started: set[Topic] = set()
        """The topics of which this process has published anything."""
        self._mirrored: dict[Topic, _Mirrored[AnyOutlet]] = {}
        self._sinks: dict[Topic, list[_Sink[AnyOutlet]]] = {}

    def __iter__(self) -> Iterator[AnyOutlet]:
        """All outlets that there are now; callable from any thread."""
        outlets = [mirrored.outlet for mirrored in list(self._mirrored.values())]
        outlets += [sink.outlet for sinks in list(self._sinks.values()) for sink in sinks]
        return iter([outlet for outlet in outlets if not isinstance(outlet, Dropped)])

    def add_sink(self, data: Mapped, *, takes_setpoints: bool = False) -> None:
        """Write a DataSet to the robot's own topic, too."""
        outlet: AnyOutlet | Dropped
        gate: RateGate[tuple[Values, OnItsWay]] | None = None
        try:
            outlet = self._publishing.sink(data, takes_setpoints=takes_setpoints)
        except UaFleetError as error:
            text = f"{data.name} cannot be written to {data.side.topic}: {error}"
            outlet = Dropped(Drop.TYPE_MISSING, detail=text)
            self._inlet.put(Dropped(Drop.TYPE_MISSING, 0, text))  # said at once
        else:
            if data.side.max_rate_hz is not None:
                limited = Dropped(Drop.RATE_LIMITED)
                deliver = partial(self._send_in_turn, outlet)
                gate = RateGate(data.side.max_rate_hz, self._loop, deliver, lambda: self._inlet.put(limited))
        self._sinks.setdefault(data.topic, []).append(_Sink(outlet, data.order, gate))

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """Publish a message on all topics that it belongs to; whether it went out on any."""
        mirrored = self._mirrored.get(topic)
        if mirrored is None or not is_same_type(mirrored.metadata, metadata):
            mirrored = self._mirror(topic, metadata, mirrored, are_events=message.kind == FrameKind.EVENT)
        elif mirrored.metadata is not metadata:
            mirrored = self._mirrored[topic] = mirrored._replace(metadata=metadata)
        sinks = self._sinks.get(topic, ())
        if topic not in self._started:
            if self._delivered.is_known(topic, message.timestamp):
                self._remember(mirrored, sinks, metadata, message)
                return False
            self._started.add(topic)
            for outlet in (mirrored.outlet, *[sink.outlet for sink in sinks]):
                if not isinstance(outlet, Dropped):
                    outlet.supersede()
        way = OnItsWay(1 + len(sinks), partial(self._delivered.note, topic, message.timestamp))
        sent = False
        if not (sinks and isinstance(mirrored.outlet, Dropped)):  # what reaches its sink needs no form as a UA topic
            sent = self._send(mirrored.outlet, () if mirrored.form is None else mirrored.form.values(message), way)
        else:
            way.failed()
        for sink in sinks:
            try:
                values = sink.order.arranged(metadata, message.values)
            except FieldMissing as error:
                self._inlet.put(Dropped(Drop.CONVERSION, detail=str(error)))
                way.failed()
                continue
            if sink.gate is None:
                sent = self._send(sink.outlet, values, way) or sent
            else:
                sink.gate.offer((values, way))
                sent = True
        return sent

    def _remember(
        self,
        mirrored: _Mirrored[AnyOutlet],
        sinks: Sequence[_Sink[AnyOutlet]],
        metadata: DataSetMetaData,
        message: DataSetMessage,
    ) -> None:
        """Only late subscribers get a message that the bridge before this one had published."""
        self._inlet.put(Dropped(Drop.REPEATED))
        with contextlib.suppress(ConversionError):  # it could not be published before either
            if not isinstance(mirrored.outlet, Dropped) and mirrored.form is not None:
                mirrored.outlet.remember(mirrored.form.values(message))
        for sink in sinks:
            if not isinstance(sink.outlet, Dropped):
                with contextlib.suppress(ConversionError, FieldMissing):
                    sink.outlet.remember(sink.order.arranged(metadata, message.values))

    def setpoint_problem(self, topic: Topic) -> str:
        """See Driver."""
        for sink in self._sinks.get(topic, ()):
            if isinstance(sink.outlet, Dropped):
                return sink.outlet.detail
            if not sink.outlet.listeners:
                return f"{sink.outlet.name} has no subscriber in ROS"
        return ""

    def write_setpoint(self, topic: Topic, values: Values) -> None:
        """See Driver."""
        for sink in self._sinks.get(topic, ()):
            if isinstance(sink.outlet, Dropped):
                self._inlet.put(sink.outlet)
                continue
            try:
                is_written = sink.outlet.write(values)
            except self._publishing.failures as error:
                self._inlet.put(Dropped(Drop.CONVERSION, detail=f"{sink.outlet.name}: {error}"))
            else:
                if not is_written:
                    self._inlet.put(Dropped(Drop.NOT_CONNECTED))

    def close(self) -> None:
        """Hand nothing on of what waits for its turn: the next bridge will, since it is not noted as delivered."""
        for sinks in self._sinks.values():
            for sink in sinks:
                if sink.gate is not None:
                    sink.gate.close()

    def _send_in_turn(self, outlet: AnyOutlet, item: tuple[Values, OnItsWay]) -> None:
        self._send(outlet, *item)

    def _send(self, outlet: AnyOutlet | Dropped, values: Values, way: OnItsWay) -> bool:
        if isinstance(outlet, Dropped):
            self._inlet.put(outlet)
            way.failed()
            return False
        try:
            lost = outlet.publish(values, way.gone)
        except self._publishing.failures as error:
            self._inlet.put(Dropped(Drop.CONVERSION, detail=f"{outlet.name}: {error}"))
            way.failed()
            return False
        self.count_lost(outlet.name, lost)
        return True

    def count_lost(self, name: str, lost: int) -> None:
        """Messages that were held for subscribers that are still connecting, and are not held any more."""
        if lost:
            self._inlet.put(Dropped(Drop.INLET_FULL, lost, f"{name}: more messages than are held at its start"))

    def _mirror(
        self, topic: Topic, metadata: DataSetMetaData, before: _Mirrored[AnyOutlet] | None, *, are_events: bool
    ) -> _Mirrored[AnyOutlet]:
        if before is None and len(self._mirrored) >= MAX_MIRRORED:
            text = f"more than {MAX_MIRRORED} topics of other spaces"
            return _Mirrored(metadata, Dropped(Drop.UNKNOWN_SOURCE, detail=text))
        replaced = None if before is None or isinstance(before.outlet, Dropped) else before.outlet
        if replaced is not None:
            self.count_lost(replaced.name, self._publishing.retire(replaced))
        made: AnyOutlet | None = None
        try:
            form = form_of(topic, metadata, {} if topic in self._sinks else self._named)
            # A Variable of the server is a state; a robot's message is an event unless the robot says otherwise.
            latched = not are_events and (topic.space == SERVER_SPACE or is_latched(metadata.fields))
            made, form = self._publishing.mirror(f"/{topic.name}", form, latched=latched, are_events=are_events)
            mirrored = _Mirrored(metadata, made, form)
        except UaFleetError as error:
            text = f"{topic.name} cannot be published here: {error}"
            mirrored = _Mirrored[AnyOutlet](metadata, Dropped(Drop.TYPE_MISSING, detail=text))
        self._mirrored[topic] = mirrored
        self._publishing.changed(made, replaced)
        return mirrored
