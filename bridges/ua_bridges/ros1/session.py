"""The ROS 1 driver: one node in the graph, a thread that watches it, and the topics on both ways."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping
from dataclasses import replace

from ua_bridges.ros.delivered import Delivered, state_folder
from ua_bridges.ros.feed import Feed, MappedFeed
from ua_bridges.ros.form import named_types
from ua_bridges.ros.served import Served
from ua_bridges.ros.topic_mapping import TopicMapping
from ua_bridges.ros1.config import Ros1BridgeConfig
from ua_bridges.ros1.master import RosMaster
from ua_bridges.ros1.memory import LatchMemory
from ua_bridges.ros1.node import RosNode
from ua_bridges.ros1.outlet import Outlet
from ua_bridges.ros1.outlets import Outlets
from ua_bridges.ros1.watch import Watch
from ua_fleet.bridge.configured import configured_sinks, configured_sources
from ua_fleet.bridge.driver import Driver, DriverStatus, Dropped, Inlet
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.teleoperation import teleoperations
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["Ros1Driver"]


class Ros1Driver(Driver):
    """See `ua_fleet.bridge.driver.Driver`."""

    takes_packed_arrays = True

    def __init__(self, config: FleetConfig, bridge_name: str) -> None:
        bridge = config.bridges[bridge_name]
        assert isinstance(bridge, Ros1BridgeConfig)
        self._bridge = bridge
        self._sources = configured_sources(config, bridge_name, TopicMapping)
        self._sinks = configured_sinks(config, bridge_name, TopicMapping)
        self._driven = {model.data for model in teleoperations(config, bridge_name)}
        self._named = named_types(config)
        self._name, self._pubsub = bridge_name, config.pubsub
        self._node: RosNode | None = None
        self._watch: Watch | None = None
        self._outlets: Outlets | None = None

    async def start(self, inlet: Inlet) -> None:
        """See Driver."""
        loop, bridge = asyncio.get_running_loop(), self._bridge
        self._inlet = inlet
        self._node = node = await asyncio.to_thread(RosNode, bridge.node_name, bridge.master_uri, bridge.host_ip)
        identity = ("ros1", self._name, bridge.master_uri, self._pubsub.url, self._pubsub.interface)
        self._delivered = Delivered(state_folder(), *identity)
        self._memory, self._served = LatchMemory(state_folder(), *identity), Served(state_folder(), *identity)
        self._outlets = outlets = Outlets(inlet, loop, self._delivered, self._outlets_changed, self._named)
        mapped: dict[str, list[Feed]] = {}
        for source in self._sources:
            mapped.setdefault(source.side.own_topic, []).append(MappedFeed(source, inlet, loop))
        for sink in self._sinks:
            is_driven = sink.topic in self._driven
            outlets.add_sink(sink.topic, sink.name, sink.config, sink.order, takes_setpoints=is_driven)
        for name, feed in self._skill_feeds(node, inlet):
            mapped.setdefault(name, []).append(feed)
        self._offenders = Offenders(inlet)
        self._watch = Watch(
            bridge.space,
            node,
            RosMaster(bridge.master_uri, node.name),
            inlet,
            loop,
            mapped,
            outlets,
            self._memory,
            self._served,
            self._spoken(),
            self._offenders,
        )
        self._watch.start()

    def _skill_feeds(self, node: RosNode, inlet: Inlet) -> Iterable[tuple[str, Feed]]:
        """Who hears which topics for skills; a driver with skills has some."""
        return ()

    def _spoken(self) -> Mapping[str, str]:
        """Type of each topic that skills publish."""
        return {}

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """See Driver."""
        if self._node is None or self._outlets is None or self._watch is None or self._watch.is_evicted:
            self._inlet.put(Dropped(Drop.NOT_CONNECTED, detail=self.status().detail))
            return False
        return self._outlets.publish(topic, metadata, message)

    def setpoint_problem(self, topic: Topic) -> str:
        """See Driver."""
        if self._node is None or self._outlets is None or self._watch is None or self._watch.is_evicted:
            return f"the bridge is not in ROS: {self.status().detail}"
        return self._outlets.setpoint_problem(topic)

    def write_setpoint(self, topic: Topic, values: tuple[float, ...]) -> None:
        """See Driver."""
        if self._node is not None and self._outlets is not None:
            self._outlets.write_setpoint(topic, values)

    def status(self) -> DriverStatus:
        """See Driver."""
        if self._watch is None:
            return DriverStatus(False, "not started")
        return replace(self._watch.status, aside=self._offenders.told(time.monotonic()))

    async def stop(self) -> None:
        """See Driver."""
        node, self._node = self._node, None
        if node is None:
            return
        if self._outlets is not None:
            self._outlets.close()
        if self._watch is not None:
            await asyncio.to_thread(self._watch.leave)
        await asyncio.to_thread(node.close)
        self._delivered.close()
        self._memory.close()
        self._served.close()

    def _outlets_changed(self, replaced: Outlet | None) -> None:
        if self._watch is not None:
            self._watch.outlets_changed(replaced)
