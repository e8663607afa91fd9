"""The Niryo Ned: an arm that picks covers from the storage and places them on a carrier.

The conveyor belt is wired to the arm, so the arm knows at once when it stops. Its rule, from the paper: while the belt
runs, place on the belt; otherwise, if the park is busy and the bucket is free, place in the bucket of the TurtleBot3;
otherwise wait.
"""

from __future__ import annotations

import argparse
import math
import threading
import time
from typing import Any

from ua_demo.report import report
from ua_demo.ros_node import RosNode, connect

COVERS = 4
PICK_S = 3.0
PLACE_ON_CONVEYOR_S = 2.5
PLACE_IN_BUCKET_S = 3.5
"""A cycle takes 5.5 or 6.5 s, "around 5 or 7 seconds" in the paper."""
FIRST_START_S = 2.5
PERIOD_S = 10.0
"""From the start of one cycle to the start of the next while the belt runs."""
REST_AFTER_BUCKET_S = 31.0
"""After a cover was given to the TurtleBot3 the arm is in no hurry: its only carrier is under way."""
JOINT_STATE_HZ = 5.0
JOINTS = ("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6")


class Ned:
    """The arm's program."""

    def __init__(self, node: RosNode, own_space: int, turtlebot_space: int, speed: float) -> None:
        self._node = node
        self._speed = speed
        self._park_busy: bool | None = None
        self._bucket_busy: bool | None = None
        self._conveyor_on = True
        self._started_s = math.inf
        self._set_conveyor = node.publisher(f"ua_{own_space}_2_1001", "std_msgs/Bool")
        self._set_on_conveyor = node.publisher(f"ua_{own_space}_2_1002", "std_msgs/Int32")
        self._set_on_turtlebot = node.publisher(f"ua_{own_space}_2_1003", "std_msgs/Int32")
        self._set_in_storage = node.publisher(f"ua_{own_space}_2_1004", "std_msgs/Int32")
        self._set_joints = node.publisher(f"ua_{own_space}_2_1005", "sensor_msgs/JointState", latched=False)
        node.subscribe(f"ua_{turtlebot_space}_2_1011", "std_msgs/Bool", self._park)
        node.subscribe(f"ua_{turtlebot_space}_2_1012", "std_msgs/Bool", self._bucket)
        node.subscribe("/conveyor/switch", "std_msgs/Bool", self._switch)
        self._tell_start = node.publisher("/line/started", "std_msgs/Float64")
        self._joints_thread = threading.Thread(target=self._publish_joints, daemon=True)

    def _park(self, message: Any) -> None:
        self._park_busy = bool(message.data)
        report("ned", "hears of the park", busy=self._park_busy)

    def _bucket(self, message: Any) -> None:
        self._bucket_busy = bool(message.data)
        report("ned", "hears of the bucket", busy=self._bucket_busy)

    def _switch(self, message: Any) -> None:
        if bool(message.data) != self._conveyor_on:
            self._conveyor_on = bool(message.data)
            report("ned", "sees the conveyor", on=self._conveyor_on)
            self._set_conveyor(self._conveyor_on)

    def _publish_joints(self) -> None:
        phase = 0.0
        while not self._node.stopped.wait(1 / JOINT_STATE_HZ):
            phase += 0.1
            message = self._node.message("sensor_msgs/JointState")
            message.name = list(JOINTS)
            message.position = [math.sin(phase + index) for index in range(len(JOINTS))]
            self._set_joints(message)

    def _sleep_until(self, line_s: float) -> None:
        """Wait until `line_s` seconds of the line's time have passed."""
        self._node.wait(self._started_s + line_s / self._speed - time.time())

    def _line_s(self) -> float:
        return (time.time() - self._started_s) * self._speed

    def _may_place_in_bucket(self) -> bool:
        return self._park_busy is True and self._bucket_busy is False

    def run(self) -> None:
        """Work until the storage is empty, then stay in the graph until told to stop."""
        on_conveyor = on_turtlebot = 0
        in_storage = COVERS
        self._set_conveyor(True)
        self._set_on_conveyor(0)
        self._set_on_turtlebot(0)
        self._set_in_storage(in_storage)
        self._joints_thread.start()
        report("ned", "is ready")
        self._node.wait_until(lambda: self._park_busy is not None and self._bucket_busy is not None)
        self._started_s = time.time()
        report("ned", "starts", covers=COVERS)
        self._tell_start(self._started_s)
        next_start_s = FIRST_START_S
        while in_storage:
            self._sleep_until(next_start_s)
            begun_s = self._line_s()
            report("ned", "picks a cover")
            self._sleep_until(begun_s + PICK_S)
            in_storage -= 1
            self._set_in_storage(in_storage)
            self._node.wait_until(lambda: self._conveyor_on or self._may_place_in_bucket())
            placing_s = self._line_s()
            if self._conveyor_on:
                self._sleep_until(placing_s + PLACE_ON_CONVEYOR_S)
                on_conveyor += 1
                report("ned", "places a cover", carrier="conveyor", count=on_conveyor)
                self._set_on_conveyor(on_conveyor)
                next_start_s = begun_s + PERIOD_S
            else:
                self._sleep_until(placing_s + PLACE_IN_BUCKET_S)
                on_turtlebot += 1
                report("ned", "places a cover", carrier="turtlebot3", count=on_turtlebot)
                self._set_on_turtlebot(on_turtlebot)
                # The bucket's state travels back through two bridges: until it has, this cover fills the bucket.
                self._bucket_busy = True
                next_start_s = self._line_s() + REST_AFTER_BUCKET_S
        report("ned", "has emptied the storage")
        self._node.stopped.wait()


def main() -> None:
    """Run the arm until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ros", type=int, choices=(1, 2), default=1)
    parser.add_argument("--space", type=int, default=1)
    parser.add_argument("--turtlebot-space", type=int, default=2)
    parser.add_argument("--speed", type=float, default=1.0)
    options = parser.parse_args()
    node = connect(options.ros, "niryo_ned")
    try:
        Ned(node, options.space, options.turtlebot_space, options.speed).run()
    finally:
        node.close()


if __name__ == "__main__":
    main()
