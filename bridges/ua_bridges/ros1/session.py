# pyright: basic, reportMissingImports=false
"""The ROS 1 driver: one node in the graph, a thread that watches it, and the topics on both ways.

The watch looks at the master several times a second, since ROS 1 tells nobody about new topics. It is the only one
that talks to the master, so nothing else ever waits for it. Links between nodes do not need the master: what is
linked goes on while it is away.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from typing import Final, NamedTuple

import rospy

from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.fields import ros_type_of
from ua_bridges.ros.latched import is_latched
from ua_bridges.ros.rate import RateGate
from ua_bridges.ros.schema import ros1_type_name
from ua_bridges.ros1.classes import MessageType, TypeUnavailable, installed_type, type_from_definition
from ua_bridges.ros1.config import Ros1BridgeConfig
from ua_bridges.ros1.feed import Feed, MappedFeed, MirrorFeed
from ua_bridges.ros1.graph import GraphWatch, unregistered
from ua_bridges.ros1.master import RosMaster, SystemState
from ua_bridges.ros1.node import RosNode
from ua_bridges.ros1.outlet import HOLD_S, Outlet
from ua_bridges.ros1.source import RosSource
from ua_fleet.bridge.driver import DriverStatus, Dropped, Inlet
from ua_fleet.config.schema import DataSetConfig, FleetConfig
from ua_fleet.counters import Drop
from ua_fleet.errors import NotConnected, UaFleetError
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["Ros1Driver"]

LOOK_PERIOD_S: Final = 0.1
"""A look costs the master about half a millisecond."""
MAX_OUTLETS: Final = 2000
"""Topics of other spaces that are published here; each costs a registration, and anybody may send new ones."""


_NOTHING: Final = Dropped(Drop.TYPE_MISSING, 0)


class _Published(NamedTuple):
    """A mirrored topic as it is published, and the metadata that it was made for."""

    metadata: DataSetMetaData
    outlet: Outlet | None
    made: float
    refusal: Dropped
    """Why nothing is published, where there is no outlet."""


class _Sink(NamedTuple):
    """A robot's own topic that a DataSet of the server is written to."""

    outlet: Outlet | None
    gate: RateGate[tuple[object, ...]] | None
    made: float
    refusal: Dropped


class Ros1Driver:
    """See `ua_fleet.bridge.driver.Driver`."""

    def __init__(self, config: FleetConfig, bridge_name: str) -> None:
        bridge = config.bridges[bridge_name]
        assert isinstance(bridge, Ros1BridgeConfig)
        self._config = bridge
        self._namespace = config.fleet.namespace_index
        self._datasets = [
            (name, dataset)
            for robot in config.robots.values()
            if robot.bridge == bridge_name
            for name, dataset in robot.data.items()
            if dataset.id is not None
        ]
        self._sources: dict[str, RosSource] = {}
        self._published: dict[Topic, _Published] = {}
        self._sinks: dict[Topic, list[_Sink]] = {}
        self._registered: set[tuple[str, str]] = set()
        self._stopping = threading.Event()
        self._wake = threading.Event()
        self._status = DriverStatus(False, "not started")
        self._thread: threading.Thread | None = None
        self._node: RosNode | None = None

    # The event loop's side.

    async def start(self, inlet: Inlet) -> None:
        """See Driver."""
        self._inlet = inlet
        self._loop = asyncio.get_running_loop()
        bridge = self._config
        self._node = await asyncio.to_thread(RosNode, bridge.node_name, bridge.master_uri, bridge.host_ip)
        self._master = RosMaster(bridge.master_uri, self._node.name)
        self._status = DriverStatus(False, f"looking for the ROS master at {bridge.master_uri}")
        self._mapped = self._make_mapped_feeds()
        self._make_sinks()
        self._thread = threading.Thread(target=self._watch, name="ros1-watch", daemon=True)
        self._thread.start()

    def status(self) -> DriverStatus:
        """See Driver."""
        return self._status

    async def stop(self) -> None:
        """See Driver."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        for sinks in self._sinks.values():
            for sink in sinks:
                if sink.gate is not None:
                    sink.gate.close()
        self._stopping.set()
        self._wake.set()
        await asyncio.to_thread(self._leave, thread)

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """See Driver."""
        node = self._node
        if node is None or node.was_shut_down:
            self._inlet.put(Dropped(Drop.SEND_FAILED, detail=self._status.detail))
            return False
        published = self._published.get(topic)
        if published is None or (published.metadata is not metadata and published.metadata.fields != metadata.fields):
            published = self._make_outlet(topic, metadata)
            if published is None:
                return False
        sinks = self._sinks.get(topic, ())
        sent = False
        if published.outlet is not None:
            sent = self._send(published.outlet, message.values)
        elif not sinks:
            self._inlet.put(published.refusal)
        for sink in sinks:
            sent = self._send_sink(sink, message.values) or sent
        return sent

    def _send(self, outlet: Outlet, values: tuple[object, ...]) -> bool:
        try:
            outlet.publish(values)
        except (ConversionError, rospy.ROSException, rospy.ROSSerializationException) as error:
            self._inlet.put(Dropped(Drop.CONVERSION, detail=f"{outlet.name}: {error}"))
            return False
        return True

    def _send_sink(self, sink: _Sink, values: tuple[object, ...]) -> bool:
        if sink.outlet is None:
            self._inlet.put(sink.refusal)
            return False
        if sink.gate is None:
            return self._send(sink.outlet, values)
        sink.gate.offer(values)
        return True

    def _make_outlet(self, topic: Topic, metadata: DataSetMetaData) -> _Published | None:
        before = self._published.get(topic)
        if before is None and len(self._published) >= MAX_OUTLETS:
            self._inlet.put(Dropped(Drop.UNKNOWN_SOURCE, detail=f"more than {MAX_OUTLETS} topics of other spaces"))
            return None
        if before is not None and before.outlet is not None:
            self._forget("publisher", before.outlet.name)
            before.outlet.close()
        outlet, refusal = None, _NOTHING
        try:
            kind, names = _type_for(metadata)
            # A Variable of the server is a state, a robot's message is an event unless the robot says otherwise.
            latched = topic.space == SERVER_SPACE or is_latched(metadata.fields)
            outlet = Outlet(f"/{topic.name}", kind, names, latched=latched, partial=False)
        except UaFleetError as error:
            refusal = Dropped(Drop.TYPE_MISSING, detail=f"{topic.name} cannot be published here: {error}")
        self._published[topic] = published = _Published(metadata, outlet, time.monotonic(), refusal)
        self._wake.set()
        return published

    def _make_mapped_feeds(self) -> dict[str, list[Feed]]:
        feeds: dict[str, list[Feed]] = {}
        for name, dataset in self._datasets:
            if dataset.source is not None and dataset.id is not None:
                topic = Topic(self._config.space, self._namespace, dataset.id)
                feed = MappedFeed(topic, dataset, name, self._inlet, self._loop)
                feeds.setdefault(_absolute(dataset.source.topic), []).append(feed)
        return feeds

    def _make_sinks(self) -> None:
        for name, dataset in self._datasets:
            if dataset.sink is not None and dataset.id is not None:
                topic = Topic(SERVER_SPACE, self._namespace, dataset.id)
                self._sinks.setdefault(topic, []).append(self._make_sink(name, dataset))

    def _make_sink(self, name: str, dataset: DataSetConfig) -> _Sink:
        mapping = dataset.sink
        assert mapping is not None
        type_name = ros1_type_name(mapping.type.replace("/msg/", "/"))
        paths = [field.path or field_name or "data" for field_name, field in dataset.all_fields().items()]
        outlet, refusal = None, _NOTHING
        try:
            outlet = Outlet(
                _absolute(mapping.topic), _installed(type_name), paths, latched=mapping.latched, partial=True
            )
        except UaFleetError as error:
            refusal = Dropped(Drop.TYPE_MISSING, detail=f"{name} cannot be written to {mapping.topic}: {error}")
        gate = None
        if mapping.max_rate_hz is not None and outlet is not None:
            deliver = _deliver_to(self._send, outlet)
            gate = RateGate[tuple[object, ...]](
                mapping.max_rate_hz, self._loop, deliver, lambda: self._inlet.put(Dropped(Drop.RATE_LIMITED))
            )
        return _Sink(outlet, gate, time.monotonic(), refusal)

    # The watch's side.

    def _watch(self) -> None:
        node = self._node
        assert node is not None
        watch = GraphWatch(self._config.space)
        for name, feeds in self._mapped.items():
            self._sources[name] = RosSource(name, feeds, node, self._inlet)
        while not self._stopping.is_set():
            if node.was_shut_down:
                self._evicted(node)
                return
            state: SystemState | None = None
            try:
                state = self._master.system_state()
                self._follow(watch, state, node)
                self._status = DriverStatus(True, f"node {node.name} at the ROS master {self._config.master_uri}")
            except NotConnected as error:
                self._status = DriverStatus(False, str(error))
            self._check_links(state, node)
            self._wake.wait(LOOK_PERIOD_S)
            self._wake.clear()

    def _follow(self, watch: GraphWatch, state: SystemState, node: RosNode) -> None:
        news = watch.look(state.publishers)
        for error in news.illegal:
            self._inlet.put(Dropped(Drop.ILLEGAL_TOPIC, detail=str(error)))
        for topic in news.found:
            name = f"/{topic.name}"
            self._sources[name] = RosSource(name, [MirrorFeed(topic, self._inlet)], node, self._inlet)
        publishers = {outlet.name: outlet.kind.name for outlet, _ in self._outlets()}
        for name in self._due("publisher", publishers, state.publishers, node):
            self._master.register_publisher(name, publishers[name], node.uri)
            self._registered.add(("publisher", name))
        for name in self._due("subscriber", self._sources, state.subscribers, node):
            node.connect(name, self._master.register_subscriber(name, "*", node.uri))
            self._registered.add(("subscriber", name))

    def _due(
        self, role: str, wanted: dict[str, str] | dict[str, RosSource], known: dict[str, list[str]], node: RosNode
    ) -> list[str]:
        # A bridge that was killed may still stand in the master under our name, with a dead address: what this
        # process has not registered itself is due whatever the master says.
        missing = set(unregistered(wanted, known, node.name))
        return [name for name in wanted if name in missing or (role, name) not in self._registered]

    def _forget(self, role: str, name: str) -> None:
        self._registered.discard((role, name))

    def _outlets(self) -> list[tuple[Outlet, float]]:
        mirrored = [(each.outlet, each.made) for each in list(self._published.values()) if each.outlet is not None]
        sinks = [(sink.outlet, sink.made) for group in self._sinks.values() for sink in group if sink.outlet]
        return mirrored + sinks

    def _check_links(self, state: SystemState | None, node: RosNode) -> None:
        now = time.monotonic()
        for name, source in self._sources.items():
            publishers = None if state is None else state.publishers.get(name, ())
            if source.check(publishers, now):
                self._forget("subscriber", name)
        for outlet, made in self._outlets():
            if outlet.is_open:
                continue
            there = state is not None and ("publisher", outlet.name) in self._registered
            others = [name for name in (state.subscribers.get(outlet.name, ()) if state else ()) if name != node.name]
            if (there and outlet.is_connected(len(others))) or now > made + HOLD_S:
                self._loop.call_soon_threadsafe(outlet.open)

    def _evicted(self, node: RosNode) -> None:
        for source in self._sources.values():
            source.lose()
        self._status = DriverStatus(
            False,
            f"another node took the name {node.name}, or somebody ended it; stop the other one and restart this bridge",
        )

    def _leave(self, thread: threading.Thread) -> None:
        thread.join()
        node = self._node
        assert node is not None
        try:
            names = list(self._registered)
            self._master.unregister(
                [name for role, name in names if role == "publisher"],
                [name for role, name in names if role == "subscriber"],
                node.uri,
            )
        except NotConnected:
            pass  # then there is nobody to sign off from
        self._master.close()
        node.close()
        self._status = DriverStatus(False, "stopped")


def _absolute(topic: str) -> str:
    return topic if topic.startswith("/") else f"/{topic}"


def _installed(type_name: str) -> MessageType:
    kind = installed_type(type_name)
    if kind is None:
        package = type_name.split("/", 1)[0].replace("_", "-")
        raise TypeUnavailable(f"the message type {type_name} is not installed; install python3-{package}")
    return kind


def _type_for(metadata: DataSetMetaData) -> tuple[MessageType, tuple[str, ...]]:
    """The type to publish a DataSet with, and the flat names of its values; raises UaFleetError."""
    found = ros_type_of(metadata.fields)
    if found is None:
        raise TypeUnavailable("several fields without a ROS type, or a type that ROS does not have")
    canonical, definition, names = found
    type_name = ros1_type_name(canonical)
    if installed_type(type_name) is None and definition is not None:
        return type_from_definition(type_name, definition), names
    return _installed(type_name), names


def _deliver_to(
    send: Callable[[Outlet, tuple[object, ...]], bool], outlet: Outlet
) -> Callable[[tuple[object, ...]], object]:
    return lambda values: send(outlet, values)
