# pyright: basic, reportMissingImports=false, reportPrivateImportUsage=false
"""A robot that goes on while its bridge is killed: carrier.py SPACE. Prints what it is told.

Its program `drive` remembers executions; `/move` (geometry_msgs/Twist) is a topic, of which nobody can ask anything.
"""

import sys
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import MultiThreadedExecutor
from std_msgs.msg import String
from ua_bridges.robot import Execution
from ua_bridges.robot.ros2 import Robot

from tests.ros2_spinning import spin
from tests.saying import say

MOVE_S = 1.0
"""Longer than a test takes to see that it has begun, and to kill the bridge meanwhile."""

rclpy.init()
node = rclpy.create_node("carrier")
state = node.create_publisher(String, "/move_state", 10)


def on_move(move: Twist) -> None:
    say("told: move", move.linear.x)
    state.publish(String(data="moving"))
    threading.Timer(MOVE_S, lambda: state.publish(String(data="arrived"))).start()


robot = Robot(node, space=int(sys.argv[1]))


@robot.skill(1010)
def drive(execution: Execution, to: str, seconds: float) -> dict[str, Any]:
    say("told: drive", execution.id, to)
    time.sleep(seconds)
    return {"distance": 2.5}


node.create_subscription(Twist, "/move", on_move, 10)
executor = MultiThreadedExecutor()
executor.add_node(node)
say("ready")
spin(executor)
