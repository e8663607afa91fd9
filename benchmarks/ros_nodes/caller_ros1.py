# pyright: basic, reportMissingImports=false
"""Calls the service `/bare` of ROS 1 one time after the other, through one connection; lines as `caller_ros2.py`."""

import json
import sys
import time

import rospy
from std_srvs.srv import Trigger


def main() -> None:
    rospy.init_node("benchmark_caller", disable_rosout=True, disable_signals=True)
    rospy.wait_for_service("/bare", 20)
    call = rospy.ServiceProxy("/bare", Trigger, persistent=True)
    print("ready", flush=True)
    for line in sys.stdin:
        count, pause_s = line.split()
        times: list[float] = []
        for _ in range(int(count)):
            time.sleep(float(pause_s))
            times.append(time.monotonic())
            call()
        print(json.dumps(times), flush=True)
    rospy.signal_shutdown("done")


main()
