"""A mobile base on a flat floor: it drives straight, uses its battery, and tells where it is."""

from __future__ import annotations

import math
import threading
from typing import Final

from ua_demo.hand import Hand, Pose
from ua_demo.ros_node import RosNode

__all__ = ["PLACES", "MobileBase"]

PLACES: Final = {"table": (0.0, 0.0), "conveyor": (3.0, 0.0), "ur3": (8.0, 0.0), "handover": (5.5, 0.5)}
"""Metres; the same as in `fleet.yaml`, which ranks robots by their distance."""
SPEED_M_S: Final = 0.3
BATTERY_PER_M: Final = 0.4
TELL_S: Final = 1.0
STEP_S: Final = 0.1


class MobileBase:
    """See the module. Times are the demonstration's seconds."""

    def __init__(self, node: RosNode, x_m: float, y_m: float, battery: float, speed: float) -> None:
        self._node, self._speed = node, speed
        self._pose, self.battery = Pose(x_m, y_m), battery
        self._tell_pose = node.publisher("/pose", "geometry_msgs/PoseStamped")
        self._tell_battery = node.publisher("/battery", "std_msgs/Float32")
        threading.Thread(target=self._tell, name="telemetry", daemon=True).start()

    @property
    def x_m(self) -> float:
        """Where it is."""
        return self._pose.x_m

    @property
    def y_m(self) -> float:
        """Where it is."""
        return self._pose.y_m

    def obey(self, space: int) -> None:
        """Have it driven by hand too. It has no skill at work then: the server sees to that."""
        Hand(self._node, space, "/cmd_vel", self._pose, moved=self._use)

    def _use(self, way_m: float) -> None:
        self.battery -= BATTERY_PER_M * way_m

    def _tell(self) -> None:
        while True:
            pose = self._node.message("geometry_msgs/PoseStamped")
            pose.header.frame_id = "map"
            pose.pose.position.x, pose.pose.position.y = self.x_m, self.y_m
            half_rad = self._pose.heading_rad / 2
            pose.pose.orientation.z, pose.pose.orientation.w = math.sin(half_rad), math.cos(half_rad)
            self._tell_pose(pose)
            self._tell_battery(self.battery)
            if self._node.stopped.wait(TELL_S):
                return

    def drive(self, place: str, canceled: threading.Event, *, share: float = 1.0) -> float:
        """Drive to a place, or a share of the way there; the metres that it was. Stops when it is canceled."""
        to_x, to_y = PLACES[place]
        way_x, way_y = (to_x - self.x_m) * share, (to_y - self.y_m) * share
        from_x, from_y, from_battery = self.x_m, self.y_m, self.battery
        way_m = math.hypot(way_x, way_y)
        if way_m:
            self._pose.heading_rad = math.atan2(way_y, way_x)
        steps = max(1, math.ceil(way_m / SPEED_M_S / STEP_S / self._speed))
        for step in range(1, steps + 1):
            if canceled.wait(way_m / SPEED_M_S / self._speed / steps):
                break
            done = step / steps
            self._pose.x_m, self._pose.y_m = from_x + way_x * done, from_y + way_y * done
            self.battery = from_battery - BATTERY_PER_M * way_m * done
        return math.hypot(self.x_m - from_x, self.y_m - from_y)
