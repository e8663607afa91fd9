# pyright: basic, reportMissingImports=false
"""The same robot as `carrier_ros2.py` with rospy: `carrier_ros1.py TIMEOUT_S [waited]`."""

import sys
import threading
import time
from typing import Any

import rospy
from geometry_msgs.msg import Twist
from ua_bridges.robot import Execution
from ua_bridges.robot.ros1 import Robot
from waited import waited  # type: ignore[import-not-found]

lock = threading.Lock()
tells_waited = sys.argv[-1] == "waited"


def say(what: str, twist: Any) -> None:
    with lock:
        print(what, time.monotonic(), twist.linear.x, twist.angular.z, flush=True)
        if tells_waited:
            print(waited(), flush=True)


rospy.init_node("carrier", disable_rosout=True)
robot = Robot()
rospy.Subscriber("/cmd_vel", Twist, lambda twist: say("heard", twist), queue_size=10, tcp_nodelay=True)


@robot.driven("/cmd_vel", Twist, timeout_s=float(sys.argv[1]))
def move(twist: Any) -> None:
    say("moved", twist)


@robot.skill(1010)
def wave(execution: Execution, seconds: float) -> None:
    execution.canceled.wait(seconds)


print("ready", flush=True)
rospy.spin()
