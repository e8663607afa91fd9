# pyright: basic, reportMissingImports=false
"""The robot of the benchmark `skill_start` in ROS 1: what `starter_ros2.py` is in ROS 2, in rospy."""

import json
import sys
import time

import rospy
from std_srvs.srv import Trigger
from ua_bridges.robot import Execution
from ua_bridges.robot.ros1 import Robot


def main() -> None:
    rospy.init_node("benchmark_starter", disable_rosout=True, disable_signals=True)
    began: list[float] = []
    now = time.monotonic

    @Robot().skill(1020, at_once=50)
    def go(execution: Execution, to: float) -> None:
        began.append(now())

    def bare(request: object) -> list[object]:
        began.append(now())
        return [True, ""]

    rospy.Service("/bare", Trigger, bare)
    print("ready", flush=True)
    for _ in sys.stdin:
        taken = began[:]
        del began[: len(taken)]
        print(json.dumps(taken), flush=True)
    rospy.signal_shutdown("done")


main()
