# pyright: basic, reportMissingImports=false
"""A ROS 2 robot that is driven by hand: `carrier_ros2.py SPACE TIMEOUT_S [waited]`.

Prints what arrives on its topic (`heard`), what its own watch lets through (`moved`), both with the monotonic time, and
what its skill does; with `waited` also how long its threads have waited for a core, each time.
"""

import sys
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile
from ua_bridges.robot import Execution
from ua_bridges.robot.ros2 import Robot
from waited import waited  # type: ignore[import-not-found]

from tests.ros2_spinning import spin_node

lock = threading.Lock()
tells_waited = sys.argv[-1] == "waited"


def say(what: str, twist: Any) -> None:
    with lock:
        print(what, time.monotonic(), twist.linear.x, twist.angular.z, flush=True)
        if tells_waited:
            print(waited(), flush=True)


rclpy.init()
node = rclpy.create_node("carrier")
robot = Robot(node, space=int(sys.argv[1]))
node.create_subscription(Twist, "/cmd_vel", lambda twist: say("heard", twist), QoSProfile(depth=10))


@robot.driven("/cmd_vel", Twist, timeout_s=float(sys.argv[2]))
def move(twist: Any) -> None:
    say("moved", twist)


@robot.skill(1010)
def wave(execution: Execution, seconds: float) -> None:
    execution.canceled.wait(seconds)


print("ready", flush=True)
spin_node(node)
