# pyright: basic, reportMissingImports=false
"""The ROS 1 driver whose robots have skills."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping, Sequence

from ua_bridges.ros.feed import Feed
from ua_bridges.ros.ports import RobotSkills, SkilledDriver, port_maker
from ua_bridges.ros.skills import SkillSpec
from ua_bridges.ros1.master import SystemState
from ua_bridges.ros1.node import RosNode
from ua_bridges.ros1.session import Ros1Driver
from ua_bridges.ros1.skills.action import Ros1ActionPort
from ua_bridges.ros1.skills.feed import SkillFeed
from ua_bridges.ros1.skills.graph import Ros1Graph
from ua_bridges.ros1.skills.service import Ros1ServicePort
from ua_bridges.ros1.skills.thread import SkillThread
from ua_fleet.bridge.driver import Inlet
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import RobotOffline

__all__ = ["SkilledRos1Driver"]

_NOTHING = SystemState({}, {}, {})


class SkilledRos1Driver(SkilledDriver, Ros1Driver):
    """See `ua_fleet.bridge.driver.Driver`."""

    def __init__(self, config: FleetConfig, bridge_name: str, specs: Sequence[SkillSpec]) -> None:
        super().__init__(config, bridge_name)
        self._specs = specs
        self._skill_thread: SkillThread | None = None
        self._graph: Ros1Graph | None = None
        self._offers = tuple([spec.offer() for spec in specs])

    def _skill_feeds(self, node: RosNode, inlet: Inlet) -> Iterable[tuple[str, Feed]]:
        self._skill_thread = thread = SkillThread()
        self._skills = skills = RobotSkills(
            self._specs, port_maker(Ros1ServicePort, Ros1ActionPort), inlet.put, thread.call
        )
        self._graph = graph = Ros1Graph(
            node.name,
            self._bridge.master_uri,
            lambda: self._watch.state if self._watch is not None else _NOTHING,
            thread.call,
            inlet.put,
        )
        skills.opened(graph)
        thread.start(skills.turn, lambda: skills.is_busy)
        return [
            (listened.name, SkillFeed(listened, thread.call, inlet.put))
            for port in skills
            for listened in port.listened()
        ]

    def _spoken(self) -> Mapping[str, str]:
        return self._graph.spoken if self._graph is not None else {}

    async def stop(self) -> None:
        """See Driver."""
        thread, self._skill_thread = self._skill_thread, None
        if thread is not None:
            await asyncio.to_thread(thread.stop)
            for port in self._skills:
                if isinstance(port, Ros1ServicePort):
                    port.close()
        await super().stop()

    def _check_node(self) -> None:
        if self._skill_thread is None or self._watch is None or self._watch.is_evicted:
            raise RobotOffline(f"the bridge is not in its graph: {self.status().detail}")
