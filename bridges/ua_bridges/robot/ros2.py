# pyright: basic, reportMissingImports=false
"""Skills of a program that uses rclpy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from ua_bridges.robot.driven import DrivenByTopics
from ua_bridges.robot.program import Announcer, Program

__all__ = ["Robot"]

_QOS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
_LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)
_LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)

Function = Callable[..., Mapping[str, Any] | None]


class Robot(Announcer, DrivenByTopics):
    """A robot in a ROS 2 domain."""

    def __init__(self, node: Any, *, space: int, namespace: int = 2, fault_id: int | None = None) -> None:
        """Offer skills from a node that somebody spins.

        Args:
            node: of rclpy.
            space: id of the ROS 2 domain.
            namespace: index of the fleet's namespace.
            fault_id: of the robot in `fleet.yaml`; needed for `fault` and `repaired`.
        """
        self._node, self._space, self._namespace = node, space, namespace
        super().__init__(None if fault_id is None else self._latched(f"/ua_{space}_{namespace}_{fault_id}"))

    def _latched(self, name: str) -> Callable[[str], None]:
        publisher = self._node.create_publisher(String, name, _LATCHED)
        return lambda text: publisher.publish(String(data=text))

    def _hear_speeds(self, topic: str, kind: type[Any], take: Callable[[Any], None]) -> None:
        self._node.create_subscription(kind, topic, take, _LATEST)

    def skill(self, id: int, *, name: str | None = None, at_once: int = 1) -> Callable[[Function], Function]:
        """Offer a function as a skill.

        Args:
            id: of the skill in `fleet.yaml`.
            name: of the skill there; the function's name if left out.
            at_once: executions that may be under way.
        """

        def offer(function: Function) -> Function:
            where = f"_{self._namespace}_{id}"
            publisher = self._node.create_publisher(String, f"/ua_{self._space}{where}", _QOS)
            wanted = name or str(getattr(function, "__name__", id))
            program = Program(wanted, function, lambda text: publisher.publish(String(data=text)), at_once=at_once)
            self._node.create_subscription(String, f"/ua_0{where}", lambda heard: program.receive(heard.data), _QOS)
            return function

        return offer
