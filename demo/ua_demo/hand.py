"""A demonstration's robot that somebody drives by hand: where speeds bring it on a flat floor."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from ua_demo.ros_node import RosNode

__all__ = ["ROBOT_TIMEOUT_S", "Hand", "Pose"]

ROBOT_TIMEOUT_S: Final = 0.5
"""`robot_timeout_ms` in the templates of `fleet.yaml`."""


class Pose:
    """Where a robot stands, and where its last speed brings it. Pure; time is an argument."""

    def __init__(self, x_m: float = 0.0, y_m: float = 0.0) -> None:
        self.x_m, self.y_m, self.heading_rad = x_m, y_m, 0.0
        self._linear = self._angular = 0.0
        self._at: float | None = None

    def go(self, linear: float, angular: float, now: float) -> float:
        """Take another speed, in m/s and rad/s; the metres that the one before has made."""
        after_s = 0.0 if self._at is None else now - self._at
        way_m = self._linear * after_s
        heading = self.heading_rad + self._angular * after_s / 2
        self.x_m += way_m * math.cos(heading)
        self.y_m += way_m * math.sin(heading)
        self.heading_rad = math.remainder(self.heading_rad + self._angular * after_s, math.tau)
        self._linear, self._angular, self._at = linear, angular, now
        return abs(way_m)


class Hand:
    """Has a robot's pose follow the speeds of `topic`, within the robot's own watch."""

    def __init__(
        self, node: RosNode, space: int, topic: str, pose: Pose, *, moved: Callable[[float], None] = lambda _m: None
    ) -> None:
        """Begin to listen.

        Args:
            node: the robot's.
            space: ROS 2 domain.
            topic: of a geometry_msgs/Twist.
            pose: is changed while somebody drives, and by nobody else then.
            moved: told of the metres of each step.
        """
        self._pose, self._moved = pose, moved
        self._lock = threading.Lock()
        kind = node.message("geometry_msgs/Twist").__class__
        self._watch: Any = node.robot(space).driven(topic, kind, timeout_s=ROBOT_TIMEOUT_S)(self._go)

    @property
    def is_on(self) -> bool:
        """Whether somebody drives: speeds come, and be they zero."""
        return not self._watch.is_stopped

    def _go(self, twist: Any) -> None:
        with self._lock:
            self._moved(self._pose.go(twist.linear.x, twist.angular.z, time.monotonic()))
