# pyright: basic, reportMissingImports=false
"""The ROS 2 driver: one node with its thread, and the topics on both ways."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable

from ua_bridges.ros.delivered import Delivered, state_folder
from ua_bridges.ros.driver import RosDriver
from ua_bridges.ros.outlets import Outlets
from ua_bridges.ros.served import Served
from ua_bridges.ros2.arrivals import Arrivals
from ua_bridges.ros2.config import Ros2BridgeConfig
from ua_bridges.ros2.node import Ros2Node
from ua_bridges.ros2.publishing import Ros2Publishing
from ua_bridges.ros2.thread import NodeThread
from ua_bridges.ros2.watch import Listener, Watch
from ua_fleet.bridge.driver import DriverStatus, Inlet
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.config.nodes import max_ages_of
from ua_fleet.config.schema import FleetConfig

__all__ = ["Ros2Driver"]


class Ros2Driver(RosDriver):
    """See `ua_fleet.bridge.driver.Driver`."""

    def __init__(self, config: FleetConfig, bridge_name: str) -> None:
        super().__init__(config, bridge_name)
        bridge = config.bridges[bridge_name]
        assert isinstance(bridge, Ros2BridgeConfig)
        self._config = bridge
        self._identity = ("ros2", bridge.space, bridge_name, config.pubsub.url, config.pubsub.interface)
        self._max_wait_s, self._max_ages = config.pubsub.max_wait_s, max_ages_of(config)
        self._thread = NodeThread(bridge.space, bridge.node_name, bridge.discovery)
        self._delivered, self._served = Delivered(None), Served(None)
        self._stopped = False

    async def start(self, inlet: Inlet) -> None:
        """See Driver."""
        self._inlet = inlet
        loop = asyncio.get_running_loop()
        written = {data.side.own_topic for data in self._sinks}
        folder = state_folder()
        self._delivered = Delivered(folder, *self._identity)
        self._served = Served(folder, *self._identity)
        self._offenders = Offenders(inlet)
        self._watch = Watch(
            self._config,
            Arrivals(inlet, self._max_wait_s, max_ages=self._max_ages),
            self._sources,
            written,
            self._served,
            loop,
            self._thread.wake_at,
            self._offenders,
            self._listened(inlet),
        )
        await self._thread.start(self._opened, self._turn, self._watch.closing)
        publishing = Ros2Publishing(self._watch, self._thread.call)
        self._outlets = outlets = Outlets(inlet, loop, self._delivered, publishing, self._named)
        self._add_sinks(outlets)

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
        if self._outlets is not None:
            self._outlets.close()
        await self._thread.stop()
        self._delivered.close()
        self._served.close()

    @property
    def _has_node(self) -> bool:
        return self._thread.running

    @property
    def _is_in_graph(self) -> bool:
        return self._thread.running
