"""The TurtleBot3 Waffle Pi: the substitute carrier with a bucket on top.

Its rule, from the paper: if the park is busy and the bucket is busy, move to the human worker; otherwise wait. The park
is busy while the robot stands there. The bucket is busy from the moment when the arm's count of covers placed in it
rises until the worker has taken the cover.

It can be driven by hand too. Its own way waits meanwhile, and goes on from where it was brought.
"""

from __future__ import annotations

import argparse
import math
import threading
import time
from typing import Any

from ua_demo.hand import Hand, Pose
from ua_demo.report import report
from ua_demo.ros_node import RosNode, connect

WAY_TO_WORKER_S = 20.5
WAY_TO_PARK_S = 20.5
POSE_HZ = 5.0
WORKER_X_M = 3.0


class TurtleBot3:
    """The mobile robot's program."""

    def __init__(self, node: RosNode, own_space: int, arm_space: int, speed: float) -> None:
        self._node = node
        self._speed = speed
        self._covers_given = 0
        self._carried = 0
        self._heard_count = False
        self._cover_taken = threading.Event()
        self._pose = Pose()
        self._hand = Hand(node, own_space, "/cmd_vel", self._pose)
        self._set_park = node.publisher(f"ua_{own_space}_2_1011", "std_msgs/Bool")
        self._set_bucket = node.publisher(f"ua_{own_space}_2_1012", "std_msgs/Bool")
        self._set_pose = node.publisher(f"ua_{own_space}_2_1013", "geometry_msgs/PoseStamped", latched=False)
        self._set_at_worker = node.publisher("/turtlebot3/at_worker", "std_msgs/Bool")
        node.subscribe(f"ua_{arm_space}_2_1003", "std_msgs/Int32", self._count)
        node.subscribe("/worker/took_cover", "std_msgs/Int32", self._taken)
        self._pose_thread = threading.Thread(target=self._publish_pose, daemon=True)

    def _count(self, message: Any) -> None:
        if message.data > self._covers_given or not self._heard_count:
            report("turtlebot3", "hears of covers for its bucket", count=int(message.data))
        self._heard_count = True
        if message.data < self._covers_given:  # the arm has begun anew
            self._carried = 0
        self._covers_given = int(message.data)

    def _taken(self, _message: Any) -> None:
        self._cover_taken.set()

    def _publish_pose(self) -> None:
        while not self._node.stopped.wait(1 / POSE_HZ):
            message = self._node.message("geometry_msgs/PoseStamped")
            message.header.frame_id = "map"
            message.pose.position.x, message.pose.position.y = self._pose.x_m, self._pose.y_m
            message.pose.orientation.z = math.sin(self._pose.heading_rad / 2)
            message.pose.orientation.w = math.cos(self._pose.heading_rad / 2)
            self._set_pose(message)

    def _drive(self, to_x_m: float, line_s: float) -> None:
        pose, pace_m_s = self._pose, WORKER_X_M * self._speed / line_s
        while True:
            self._node.wait_until(lambda: not self._hand.is_on)
            lasts_s = math.hypot(to_x_m - pose.x_m, pose.y_m) / pace_m_s
            if not lasts_s:
                return
            pose.heading_rad = math.atan2(-pose.y_m, to_x_m - pose.x_m)
            begun, start_x_m, start_y_m = time.time(), pose.x_m, pose.y_m
            while (done := (time.time() - begun) / lasts_s) < 1 and not self._hand.is_on:
                pose.x_m, pose.y_m = start_x_m + (to_x_m - start_x_m) * done, start_y_m * (1 - done)
                self._node.wait(min(0.02, lasts_s / 20))
            if done >= 1:
                pose.x_m, pose.y_m = to_x_m, 0.0

    def run(self) -> None:
        """Carry covers until told to stop."""
        self._set_park(True)
        self._set_bucket(False)
        self._set_at_worker(False)
        self._pose_thread.start()
        report("turtlebot3", "stands at the park")
        while True:
            self._node.wait_until(lambda: self._covers_given > self._carried)
            self._carried += 1
            self._set_bucket(True)
            # The park and the bucket are busy now: the robot moves.
            self._set_park(False)
            report("turtlebot3", "moves to the worker", count=self._carried)
            self._drive(WORKER_X_M, WAY_TO_WORKER_S)
            self._cover_taken.clear()
            report("turtlebot3", "arrives at the worker", count=self._carried)
            self._set_at_worker(True)
            self._node.wait_until(self._cover_taken.is_set)
            self._set_bucket(False)
            self._set_at_worker(False)
            report("turtlebot3", "moves back to the park")
            self._drive(0.0, WAY_TO_PARK_S)
            self._set_park(True)
            report("turtlebot3", "stands at the park")


def main() -> None:
    """Run the robot until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--space", type=int, default=2)
    parser.add_argument("--arm-space", type=int, default=1)
    parser.add_argument("--speed", type=float, default=1.0)
    options = parser.parse_args()
    node = connect(2, "turtlebot3")
    try:
        TurtleBot3(node, options.space, options.arm_space, options.speed).run()
    finally:
        node.close()


if __name__ == "__main__":
    main()
