"""The human worker: takes each cover from its carrier and assembles a box with it.

The worker stands at the end of the belt, where a cover arrives some seconds after it was placed while the belt runs,
and takes a cover from the TurtleBot3 when that stands beside. As a ROS 2 node the worker also sees how long the arm's
messages take from ROS 1 to ROS 2.
"""

from __future__ import annotations

import argparse
import time
from collections import deque
from typing import Any

from ua_demo.report import report
from ua_demo.ros_node import RosNode, connect

BELT_S = 4.0
"""Time that a cover lies on the running belt."""
TAKE_S = 2.0


class Human:
    """The worker."""

    def __init__(self, node: RosNode, own_space: int, arm_space: int, speed: float) -> None:
        self._node = node
        self._speed = speed
        self._belt_runs = True
        self._placed_on_belt = self._seen_on_belt = 0
        self._turtlebot_here = False
        self._set_boxes = node.publisher(f"ua_{own_space}_2_1021", "std_msgs/Int32")
        self._took = node.publisher("/worker/took_cover", "std_msgs/Int32")
        node.subscribe(f"ua_{arm_space}_2_1001", "std_msgs/Bool", self._belt)
        node.subscribe(f"ua_{arm_space}_2_1002", "std_msgs/Int32", self._placed)
        node.subscribe(f"ua_{arm_space}_2_1005", "sensor_msgs/JointState", self._joints, latched=False)
        node.subscribe("/turtlebot3/at_worker", "std_msgs/Bool", self._at_worker)

    def _belt(self, message: Any) -> None:
        self._belt_runs = bool(message.data)

    def _placed(self, message: Any) -> None:
        if message.data > self._placed_on_belt:
            report("human", "hears of a cover on the belt", count=int(message.data))
        elif message.data < self._placed_on_belt:  # the arm has begun anew
            self._seen_on_belt = 0
        self._placed_on_belt = int(message.data)

    def _at_worker(self, message: Any) -> None:
        self._turtlebot_here = bool(message.data)

    def _joints(self, message: Any) -> None:
        stamp = message.header.stamp
        seconds = stamp.sec + stamp.nanosec / 1e9
        report("human", "hears of the joints", delay_ms=(time.time() - seconds) * 1000)

    def run(self) -> None:
        """Assemble until told to stop."""
        boxes = 0
        on_belt: deque[float] = deque()
        served_turtlebot = False
        self._set_boxes(0)
        report("human", "is ready")
        last = time.time()
        while True:
            self._node.wait(0.01)
            now = time.time()
            elapsed_s, last = (now - last) * self._speed, now
            if self._belt_runs:
                on_belt = deque(left - elapsed_s for left in on_belt)
            while self._seen_on_belt < self._placed_on_belt:
                self._seen_on_belt += 1
                on_belt.append(BELT_S)
            if on_belt and on_belt[0] <= 0:
                on_belt.popleft()
                boxes += 1
                report("human", "takes a cover", carrier="conveyor", boxes=boxes)
                self._set_boxes(boxes)
            if not self._turtlebot_here:
                served_turtlebot = False
            elif not served_turtlebot:
                served_turtlebot = True
                self._node.wait(TAKE_S / self._speed)
                boxes += 1
                report("human", "takes a cover", carrier="turtlebot3", boxes=boxes)
                self._took(boxes)
                self._set_boxes(boxes)


def main() -> None:
    """Work until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--space", type=int, default=2)
    parser.add_argument("--arm-space", type=int, default=1)
    parser.add_argument("--speed", type=float, default=1.0)
    options = parser.parse_args()
    node = connect(2, "human_worker")
    try:
        Human(node, options.space, options.arm_space, options.speed).run()
    finally:
        node.close()


if __name__ == "__main__":
    main()
