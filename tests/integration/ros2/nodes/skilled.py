# pyright: basic, reportMissingImports=false, reportPrivateImportUsage=false
"""A robot for the tests of skills: a topic with a status, a service, and a program with the decorator.

skilled.py SPACE: prints what it is told. Move (geometry_msgs/Twist on /move) ends when a second message comes, or by
its value: linear.x 1 is done, 2 fails, 3 goes on until it is halted by 0.
"""

import sys
import threading
import time
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.srv import LoadMap
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from std_msgs.msg import String
from ua_bridges.robot import Execution, Refused
from ua_bridges.robot.ros2 import Robot

from tests.ros2_spinning import spin
from tests.saying import say

space = int(sys.argv[1])
rclpy.init()
node = rclpy.create_node("skilled")
state = node.create_publisher(String, "/move_state", 10)


def told(*what: object) -> None:
    say("told:", *what)


def publish_state(text: str) -> None:
    state.publish(String(data=text))


def on_move(move: Twist) -> None:
    told("move", move.linear.x, move.angular.z)
    publish_state("moving" if move.linear.x else "standing")
    if move.linear.x in (1.0, 2.0):
        ended = "arrived" if move.linear.x == 1.0 else "stuck"
        threading.Timer(0.2, publish_state, [ended]).start()


def on_map(request: LoadMap.Request, response: Any) -> Any:
    told("map", request.map_url)
    if request.map_url == "slow":
        time.sleep(2.0)
    response.result = 0 if request.map_url != "missing" else LoadMap.Response.RESULT_MAP_DOES_NOT_EXIST
    response.map.info.width = 7
    return response


robot = Robot(node, space=space)


@robot.skill(1010)
def drive(execution: Execution, to: str, seconds: float = 0.0) -> dict[str, Any]:
    told("drive", to)
    if to == "the moon":
        raise Refused("no way to the moon")
    if to == "the wall":
        raise RuntimeError("bumped")
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        execution.progress(1 - (end - time.monotonic()) / seconds, f"on the way to {to}")
        execution.canceled.wait(0.05)
    return {"distance": 2.5}


node.create_subscription(Twist, "/move", on_move, 10)
node.create_service(LoadMap, "/load_map", on_map, callback_group=ReentrantCallbackGroup())
executor = MultiThreadedExecutor()
executor.add_node(node)
say("ready")
spin(executor)
