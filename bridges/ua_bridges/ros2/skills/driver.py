# pyright: basic, reportMissingImports=false
"""The ROS 2 driver whose robots have skills."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from ua_bridges.ros.feed import Read
from ua_bridges.ros.ports import Listened, RobotSkills, SkilledDriver, port_maker
from ua_bridges.ros.serialized import MessageKind
from ua_bridges.ros.skills import SkillSpec
from ua_bridges.ros2.graph import LOOK_S, QUIET_LOOK_S
from ua_bridges.ros2.node import Ros2Node
from ua_bridges.ros2.session import Ros2Driver
from ua_bridges.ros2.skills.action import Ros2ActionPort
from ua_bridges.ros2.skills.ears import Ear
from ua_bridges.ros2.skills.graph import Ros2Graph
from ua_bridges.ros2.skills.service import Ros2ServicePort
from ua_bridges.ros2.source import RosSource
from ua_bridges.ros2.thread import NodeThread
from ua_fleet.bridge.driver import DriverStatus, Inlet
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import RobotOffline

__all__ = ["SkilledRos2Driver"]


class _SkillFeed:
    """What a port hears; see `ua_bridges.ros.feed.Feed`."""

    topic = None

    def __init__(self, listened: Listened) -> None:
        self._listened, self.wanted_type = listened, listened.type.replace("/msg/", "/")

    def announce(self, kind: MessageKind, latched: bool) -> None:
        """See Feed."""
        if kind.name == self.wanted_type:
            self._listened.source("")
        else:
            self.mistyped(kind.name, 0)

    def reader(self, kind: MessageKind) -> Read:
        """See Feed."""
        heard = self._listened.heard
        if kind.name != self.wanted_type:
            return lambda content, time_ns, own: None
        message = kind.message_reader()
        return lambda content, time_ns, own: heard(message(content))

    def mistyped(self, ros_type: str, time_ns: int) -> None:
        """See Feed."""
        name, wanted = self._listened.name, self.wanted_type
        self._listened.source(f"{name} carries {ros_type.replace('/msg/', '/')}, and not {wanted}; correct `type`")

    def lost(self) -> None:
        """See Feed."""
        self._listened.source(f"{self._listened.name} has no publisher; start the robot's node")


class SkilledRos2Driver(SkilledDriver, Ros2Driver):
    """See `ua_fleet.bridge.driver.Driver`.

    Skills have a node and a thread of their own in the participant of the bridge's node.
    """

    def __init__(self, config: FleetConfig, bridge_name: str, specs: Sequence[SkillSpec]) -> None:
        super().__init__(config, bridge_name)
        self._specs = specs
        self._offers = tuple([spec.offer() for spec in specs])
        name = f"{self._config.node_name}_skills"
        self._skill_thread = NodeThread(self._config.space, name, self._config.discovery, self._thread)
        self._skill_node: Ros2Node | None = None
        self._ears: list[Ear] = []

    async def start(self, inlet: Inlet) -> None:
        """See Driver."""
        await super().start(inlet)
        await self._skill_thread.start(self._skills_opened, self._skills_turn, self._skills_closing)

    async def stop(self) -> None:
        """See Driver. The node of the values ends the participant, so it ends last."""
        await self._skill_thread.stop()
        await super().stop()

    def status(self) -> DriverStatus:
        """See Driver."""
        if self._skill_thread.failure is not None:
            return DriverStatus(False, self._skill_thread.failure, is_over=True)
        return super().status()

    def _listened(self, inlet: Inlet) -> list[Ear]:
        call = self._skill_thread.call
        self._skills = RobotSkills(self._specs, port_maker(Ros2ServicePort, Ros2ActionPort), inlet.put, call)
        found: dict[str, list[Listened]] = {}
        for port in self._skills:
            for listened in port.listened():
                found.setdefault(listened.name, []).append(listened)
        self._ears = [Ear(name, partial(self._hear, each, inlet), call) for name, each in found.items()]
        return self._ears

    # The skills' thread

    def _hear(self, listened: list[Listened], inlet: Inlet) -> RosSource:
        assert self._skill_node is not None, "the watch is heard of once the skills' node is there"
        first, feeds = listened[0], [_SkillFeed(each) for each in listened]
        return RosSource(
            first.name,
            feeds,
            self._skill_node,
            inlet,
            partial(self._thread.call, self._watch.look_soon),
            wanted_type=first.type,
            qos=first.qos,
        )

    def _skills_opened(self, node: Ros2Node) -> None:
        self._skill_node = node
        self._skills.opened(Ros2Graph(node, self._inlet.put))

    def _skills_turn(self, now: float) -> float:
        self._skills.turn(now)
        return now + (LOOK_S if self._skills.is_busy else QUIET_LOOK_S)

    def _skills_closing(self) -> None:
        for ear in self._ears:
            ear.close()

    # The event loop's side

    def _check_node(self) -> None:
        if not self._skill_thread.running:
            raise RobotOffline(f"the bridge is not in its domain: {self.status().detail}")
