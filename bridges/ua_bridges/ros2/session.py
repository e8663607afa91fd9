# pyright: basic, reportMissingImports=false
"""The ROS 2 driver: one node with its thread, and the topics on both ways. This module is the event loop's side."""

from __future__ import annotations

import asyncio
import copy
import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, Final, NamedTuple

from ua_bridges.ros.codec import compile_encoder
from ua_bridges.ros.convert import compile_writer
from ua_bridges.ros.delivered import Delivered, state_folder
from ua_bridges.ros.errors import ConversionError, SchemaInvalid
from ua_bridges.ros.fields import is_same_type
from ua_bridges.ros.form import Form, form_of, named_types, with_stamp
from ua_bridges.ros.served import Served
from ua_bridges.ros.sink import compile_sink
from ua_bridges.ros.topic_mapping import TopicMapping
from ua_bridges.ros2.arrivals import Arrivals
from ua_bridges.ros2.classes import MessageType, load_type, make
from ua_bridges.ros2.config import Ros2BridgeConfig
from ua_bridges.ros2.node import Ros2Node
from ua_bridges.ros2.outlet import Make, Outlet, dropped_by
from ua_bridges.ros2.qos import MIRROR, sink_qos
from ua_bridges.ros2.thread import NodeThread
from ua_bridges.ros2.watch import Listener, Watch
from ua_fleet.bridge.configured import ConfiguredData, configured_sinks, configured_sources
from ua_fleet.bridge.driver import Driver, DriverStatus, Dropped, Inlet
from ua_fleet.bridge.gate import RateGate
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.config.nodes import max_ages_of
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Drop
from ua_fleet.errors import FieldMissing, UaFleetError
from ua_fleet.fleet.matching import FieldOrder
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["Ros2Driver"]

MAX_TOPICS: Final = 2000
"""Topics of other spaces that are published here: anybody may send new ones."""

Values = tuple[Any, ...]


class _Sink(NamedTuple):
    """A robot's own topic that a DataSet of the server is written to."""

    outlet: Outlet
    make: Make
    order: FieldOrder
    gate: RateGate[Values] | None


class _Route:
    """Where the messages of one topic go to."""

    __slots__ = ("metadata", "mirror", "reason", "sinks", "started")

    def __init__(
        self, metadata: DataSetMetaData, mirror: tuple[Outlet, Make, Form] | None, sinks: list[_Sink], reason: str
    ) -> None:
        self.metadata, self.mirror, self.sinks, self.reason = metadata, mirror, sinks, reason
        self.started = False
        """Whether anything has been published on it."""


class Ros2Driver(Driver):
    """See `ua_fleet.bridge.driver.Driver`."""

    takes_packed_arrays = True

    def __init__(self, config: FleetConfig, bridge_name: str) -> None:
        bridge = config.bridges[bridge_name]
        assert isinstance(bridge, Ros2BridgeConfig)
        self._config = bridge
        self._identity = ("ros2", bridge.space, bridge_name, config.pubsub.url, config.pubsub.interface)
        self._max_wait_s, self._max_ages = config.pubsub.max_wait_s, max_ages_of(config)
        self._mapped = configured_sources(config, bridge_name, TopicMapping)
        self._written = configured_sinks(config, bridge_name, TopicMapping)
        self._named = named_types(config)
        self._thread = NodeThread(bridge.space, bridge.node_name, bridge.discovery)
        self._routes: dict[Topic, _Route] = {}
        self._sinks: dict[Topic, list[_Sink]] = {}
        self._shared: dict[str, Outlet] = {}
        """Publishers of robots' own topics, by name."""
        self._delivered, self._served = Delivered(None), Served(None)
        self._stopped = False

    async def start(self, inlet: Inlet) -> None:
        """See Driver."""
        self._inlet = inlet
        self._loop = asyncio.get_running_loop()
        written = {data.side.own_topic for data in self._written}
        folder = state_folder()
        self._delivered = Delivered(folder, *self._identity)
        self._served = Served(folder, *self._identity)
        self._offenders = Offenders(inlet)
        self._watch = Watch(
            self._config,
            Arrivals(inlet, self._max_wait_s, max_ages=self._max_ages),
            self._mapped,
            written,
            self._served,
            self._loop,
            self._thread.wake_at,
            self._offenders,
            self._listened(inlet),
        )
        await self._thread.start(self._opened, self._turn, self._watch.closing)
        for data in self._written:
            self._add_sink(data)

    def _listened(self, inlet: Inlet) -> Iterable[Listener]:
        """Who listens to topics that are no data sources; a driver with skills has some."""
        return ()

    def _opened(self, node: Ros2Node) -> None:
        """The node is there; in its thread."""
        self._watch.opened(node)

    def _turn(self, now: float) -> float:
        """Do what is due, in the node's thread; when to be called again."""
        return self._watch.turn(now)

    def status(self) -> DriverStatus:
        """See Driver."""
        if self._thread.failure is not None:
            return DriverStatus(False, self._thread.failure, is_over=True)
        where = f"node /{self._config.node_name} in ROS 2 domain {self._config.space} ({self._config.discovery})"
        if self._thread.running:
            return DriverStatus(True, where, aside=self._offenders.told(time.monotonic()))
        return DriverStatus(False, "stopped" if self._stopped else "not started")

    async def stop(self) -> None:
        """See Driver."""
        self._stopped = True
        for sink in (sink for sinks in self._sinks.values() for sink in sinks):
            if sink.gate is not None:
                sink.gate.close()
        await self._thread.stop()
        self._delivered.close()
        self._served.close()

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """See Driver."""
        if not self._thread.running:
            self._inlet.put(Dropped(Drop.NOT_CONNECTED))
            return False
        route = self._routes.get(topic)
        if route is None or not is_same_type(route.metadata, metadata):
            route = self._make_route(topic, metadata)
            if route is None:
                return False
        route.metadata = metadata
        if not route.started:
            return self._publish_first(route, topic, message)
        return self._publish(route, topic, message)

    def setpoint_problem(self, topic: Topic) -> str:
        """See Driver."""
        if not self._thread.running:
            return f"the bridge is not in ROS: {self.status().detail}"
        outlets = [sink.outlet for sink in self._sinks.get(topic, ())]
        if not outlets:
            return "its message type is not installed here; see the log of the bridge"
        return "" if outlets[0].listeners else f"{outlets[0].name} has no subscriber in ROS"

    def write_setpoint(self, topic: Topic, values: tuple[float, ...]) -> None:
        """See Driver."""
        for sink in self._sinks.get(topic, ()):
            try:
                is_written = self._thread.running and sink.outlet.write(sink.make, values)
            except ConversionError as error:
                self._inlet.put(Dropped(Drop.CONVERSION, detail=f"{sink.outlet.name}: {error}"))
            else:
                if not is_written:
                    self._inlet.put(Dropped(Drop.NOT_CONNECTED))

    def _publish(self, route: _Route, topic: Topic, message: DataSetMessage) -> bool:
        sent = False
        values = message.values
        if route.mirror is not None:
            outlet, make_message, form = route.mirror
            sent = self._send(outlet, make_message, form.values(message))
        elif not route.sinks:
            self._inlet.put(Dropped(Drop.TYPE_MISSING, detail=route.reason))
        for sink in route.sinks:
            try:
                arranged = sink.order.arranged(route.metadata, values)
            except FieldMissing as error:
                self._inlet.put(Dropped(Drop.CONVERSION, detail=f"{sink.outlet.name}: {error}"))
                continue
            if sink.gate is None:
                sent = self._send(sink.outlet, sink.make, arranged) or sent
            else:
                sink.gate.offer(arranged)
                sent = True
        if sent:
            self._delivered.note(topic, message.timestamp)
        return sent

    def _publish_first(self, route: _Route, topic: Topic, message: DataSetMessage) -> bool:
        """The first message after a start may be one that the bridge before this one has published."""
        ways: list[tuple[Outlet, Make, FieldOrder | Form]]
        ways = [(sink.outlet, sink.make, sink.order) for sink in route.sinks]
        if route.mirror is not None:
            ways.append(route.mirror)
        if not self._delivered.is_known(topic, message.timestamp):
            route.started = bool(ways)
            for outlet, _, _ in ways:
                self._thread.call(partial(self._watch.forget, outlet.name))
            return self._publish(route, topic, message)
        self._inlet.put(Dropped(Drop.REPEATED))
        for outlet, make_message, order in ways:
            try:
                if isinstance(order, Form):
                    values = order.values(message)
                else:
                    values = order.arranged(route.metadata, message.values)
                again = copy.deepcopy(make_message(values))
            except (ConversionError, FieldMissing):
                continue  # it could not be published before either
            if outlet.qos.transient_local:
                self._thread.call(partial(self._watch.keep, outlet.name, outlet.kind.cls, again))
        return False

    def _send(self, outlet: Outlet, make_message: Make, values: Values) -> bool:
        try:
            lost = outlet.publish(make_message, values)
        except ConversionError as error:
            self._inlet.put(Dropped(Drop.CONVERSION, detail=f"{outlet.name}: {error}"))
            return False
        if lost:
            self._inlet.put(dropped_by(outlet, lost))
        return True

    def _make_route(self, topic: Topic, metadata: DataSetMetaData) -> _Route | None:
        before = self._routes.get(topic)
        if before is None and len(self._routes) >= MAX_TOPICS:
            self._inlet.put(Dropped(Drop.UNKNOWN_SOURCE, detail=f"more than {MAX_TOPICS} topics of other spaces"))
            return None
        if before is not None and before.mirror is not None:
            self._thread.call(partial(self._watch.drop, before.mirror[0]))
        sinks = self._sinks.get(topic, [])
        mirror: tuple[Outlet, Make, Form] | None = None
        reason = ""
        try:
            mirror = self._make_mirror(topic, metadata)
        except UaFleetError as error:
            reason = f"{topic.name} cannot be published here: {error}"
        route = self._routes[topic] = _Route(metadata, mirror, sinks, reason)
        if mirror is not None:
            self._thread.call(partial(self._watch.attend, mirror[0]))
        return route

    def _make_mirror(self, topic: Topic, metadata: DataSetMetaData) -> tuple[Outlet, Make, Form]:
        """The publisher of a mirrored topic; raises an UaFleetError where this space has no type for it."""
        form = form_of(topic, metadata, {} if topic in self._sinks else self._named)
        kind = load_type(form.ros_type)
        form = with_stamp(form, kind.schema)
        outlet = Outlet(f"/{topic.name}", kind, MIRROR)
        fill = compile_writer(kind.schema, form.names, make, partial=not form.is_whole)
        encode = compile_encoder(kind.schema, form.names, partial(fill, kind.cls())) if form.is_whole else None
        return outlet, encode or outlet.filling(fill), form

    def _add_sink(self, data: ConfiguredData[TopicMapping]) -> None:
        """Write the DataSet to the robot's own topic, too."""
        mapping = data.side
        paths = [(name or data.name, field.path or name or "data") for name, field in data.config.all_fields().items()]
        try:
            kind = load_type(mapping.type)
            fill = compile_sink(kind.schema, paths)
            outlet = self._shared_outlet(mapping, kind)
            make_message = outlet.filling(fill)
        except UaFleetError as error:
            reason = f"{data.name} cannot be written to {mapping.topic}: {error}"
            self._inlet.put(Dropped(Drop.TYPE_MISSING, detail=reason))
            return
        gate: RateGate[Values] | None = None
        if mapping.max_rate_hz is not None:
            deliver: Callable[[Values], object] = partial(self._send, outlet, make_message)
            gate = RateGate(mapping.max_rate_hz, self._loop, deliver, self._count_rate_limited)
        self._sinks.setdefault(data.topic, []).append(_Sink(outlet, make_message, data.order, gate))

    def _shared_outlet(self, mapping: TopicMapping, kind: MessageType) -> Outlet:
        """The one publisher of a robot's topic, for all DataSets that are written to it."""
        name = mapping.own_topic
        outlet = self._shared.get(name)
        if outlet is None:
            outlet = self._shared[name] = Outlet(name, kind, sink_qos(mapping.qos))
            self._thread.call(partial(self._watch.attend, outlet))
        elif outlet.kind is not kind:
            raise SchemaInvalid(kind.name, f"another sink writes {outlet.kind.name} to the same topic")
        return outlet

    def _count_rate_limited(self) -> None:
        self._inlet.put(Dropped(Drop.RATE_LIMITED))
