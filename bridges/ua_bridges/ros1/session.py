"""The ROS 1 driver: one node in the graph, a thread that watches it, and the topics on both ways."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping
from dataclasses import replace

from ua_bridges.ros.delivered import Delivered, state_folder
from ua_bridges.ros.driver import RosDriver
from ua_bridges.ros.feed import Feed, MappedFeed
from ua_bridges.ros.outlets import Outlets
from ua_bridges.ros.served import Served
from ua_bridges.ros1.config import Ros1BridgeConfig
from ua_bridges.ros1.master import RosMaster
from ua_bridges.ros1.memory import LatchMemory
from ua_bridges.ros1.node import RosNode
from ua_bridges.ros1.outlet import Outlet
from ua_bridges.ros1.publishing import Ros1Publishing
from ua_bridges.ros1.watch import Watch
from ua_fleet.bridge.driver import DriverStatus, Inlet
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.config.schema import FleetConfig

__all__ = ["Ros1Driver"]


class Ros1Driver(RosDriver):
    """See `ua_fleet.bridge.driver.Driver`."""

    def __init__(self, config: FleetConfig, bridge_name: str) -> None:
        super().__init__(config, bridge_name)
        bridge = config.bridges[bridge_name]
        assert isinstance(bridge, Ros1BridgeConfig)
        self._bridge = bridge
        self._name, self._pubsub = bridge_name, config.pubsub
        self._node: RosNode | None = None
        self._watch: Watch | None = None

    async def start(self, inlet: Inlet) -> None:
        """See Driver."""
        loop, bridge = asyncio.get_running_loop(), self._bridge
        self._inlet = inlet
        self._node = node = await asyncio.to_thread(RosNode, bridge.node_name, bridge.master_uri, bridge.host_ip)
        identity = ("ros1", self._name, bridge.master_uri, self._pubsub.url, self._pubsub.interface)
        self._delivered = Delivered(state_folder(), *identity)
        self._memory, self._served = LatchMemory(state_folder(), *identity), Served(state_folder(), *identity)
        publishing = Ros1Publishing(self._outlets_changed)
        self._outlets = outlets = Outlets(inlet, loop, self._delivered, publishing, self._named)
        mapped: dict[str, list[Feed]] = {}
        for source in self._sources:
            mapped.setdefault(source.side.own_topic, []).append(MappedFeed(source, inlet, loop))
        self._add_sinks(outlets)
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

    @property
    def _has_node(self) -> bool:
        return self._node is not None

    @property
    def _is_in_graph(self) -> bool:
        return self._node is not None and self._watch is not None and not self._watch.is_evicted

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
