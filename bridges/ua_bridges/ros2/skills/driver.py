# pyright: basic, reportMissingImports=false
"""The ROS 2 driver whose robots have skills."""

from __future__ import annotations

from collections.abc import Sequence

from ua_bridges.ros.ports import Listened, RobotSkills, SkilledDriver, port_maker
from ua_bridges.ros.skills import SkillSpec
from ua_bridges.ros2.classes import MessageType
from ua_bridges.ros2.feed import Read
from ua_bridges.ros2.graph import LOOK_S
from ua_bridges.ros2.node import Ros2Node
from ua_bridges.ros2.session import Ros2Driver
from ua_bridges.ros2.skills.action import ActionPort
from ua_bridges.ros2.skills.graph import Ros2Graph
from ua_bridges.ros2.skills.service import ServicePort
from ua_bridges.ros2.watch import Heard
from ua_fleet.bridge.driver import Inlet
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import RobotOffline

__all__ = ["SkilledRos2Driver"]


class _SkillFeed:
    """What a port hears; see `ua_bridges.ros2.feed.Feed`."""

    def __init__(self, listened: Listened) -> None:
        self._listened, self._wanted = listened, listened.type.replace("/msg/", "/")

    def found(self, kind: MessageType, latched: bool) -> None:
        """See Feed."""
        if kind.name == self._wanted:
            self._listened.source("")
        else:
            self.mistyped(kind.name, 0)

    def reader(self, kind: MessageType) -> Read:
        """See Feed."""
        heard = self._listened.heard
        if kind.name != self._wanted:
            return lambda message, time_ns: None
        return lambda message, time_ns: heard(message)

    def mistyped(self, ros_type: str, time_ns: int) -> None:
        """See Feed."""
        name, wanted = self._listened.name, self._wanted
        self._listened.source(f"{name} carries {ros_type.replace('/msg/', '/')}, and not {wanted}; correct `type`")

    def release(self, now: float) -> float | None:
        """Nothing waits."""
        return None

    def lost(self) -> None:
        """See Feed."""
        self._listened.source(f"nobody publishes {self._listened.name}; start the robot's node")


class SkilledRos2Driver(SkilledDriver, Ros2Driver):
    """See HaltingDriver and SuspendingDriver in `ua_fleet.bridge.driver`."""

    def __init__(self, config: FleetConfig, bridge_name: str, specs: Sequence[SkillSpec]) -> None:
        super().__init__(config, bridge_name)
        self._specs = specs
        self._offers = tuple([spec.offer() for spec in specs])
        self._look_at = 0.0

    # The node's thread

    def _listened(self, inlet: Inlet) -> list[Heard]:
        self._skills = RobotSkills(self._specs, port_maker(ServicePort, ActionPort), inlet.put, self._thread.call)
        return [
            Heard(listened.name, listened.type, listened.qos, _SkillFeed(listened))
            for port in self._skills
            for listened in port.listened()
        ]

    def _opened(self, node: Ros2Node) -> None:
        self._skills.opened(Ros2Graph(node, self._inlet.put))
        super()._opened(node)

    def _turn(self, now: float) -> float:
        due = super()._turn(now)
        if now >= self._look_at:
            self._look_at = now + LOOK_S
            self._skills.turn(now)
        return min(due, self._look_at)

    # The event loop's side

    def _check_node(self) -> None:
        if not self._thread.running:
            raise RobotOffline(f"the bridge is not in its domain: {self.status().detail}")
