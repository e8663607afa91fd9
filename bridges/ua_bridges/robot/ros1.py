# pyright: basic, reportMissingImports=false
"""Skills of a program that uses rospy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import rospy
from std_msgs.msg import String

from ua_bridges.robot.driven import DrivenByTopics
from ua_bridges.robot.program import Announcer, Program

__all__ = ["Robot"]

Function = Callable[..., Mapping[str, Any] | None]


class Robot(Announcer, DrivenByTopics):
    """A robot in the graph of a ROS 1 master; the program has called `rospy.init_node`."""

    def __init__(self, *, namespace: int = 2, fault_id: int | None = None) -> None:
        """Offer skills from this node.

        Args:
            namespace: index of the fleet's namespace.
            fault_id: of the robot in `fleet.yaml`; needed for `fault` and `repaired`.
        """
        self._namespace = namespace
        super().__init__(None if fault_id is None else self._latched(f"/ua_1_{namespace}_{fault_id}"))

    @staticmethod
    def _latched(name: str) -> Callable[[str], None]:
        publisher = rospy.Publisher(name, String, queue_size=10, latch=True, tcp_nodelay=True)
        return lambda text: publisher.publish(String(data=text))

    def _hear_speeds(self, topic: str, kind: type[Any], take: Callable[[Any], None]) -> None:
        rospy.Subscriber(topic, kind, take, queue_size=1, tcp_nodelay=True)

    def skill(self, id: int, *, name: str | None = None, at_once: int = 1) -> Callable[[Function], Function]:
        """Offer a function as a skill.

        Args:
            id: of the skill in `fleet.yaml`.
            name: of the skill there; the function's name if left out.
            at_once: executions that may be under way.
        """

        def offer(function: Function) -> Function:
            where = f"_{self._namespace}_{id}"
            publisher = rospy.Publisher(f"/ua_1{where}", String, queue_size=100, tcp_nodelay=True)
            wanted = name or str(getattr(function, "__name__", id))
            program = Program(wanted, function, lambda text: publisher.publish(String(data=text)), at_once=at_once)
            rospy.Subscriber(f"/ua_0{where}", String, lambda heard: program.receive(heard.data), tcp_nodelay=True)
            return function

        return offer
