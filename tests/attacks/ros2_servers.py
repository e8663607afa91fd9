# pyright: basic, reportMissingImports=false, reportPrivateImportUsage=false
"""Servers of services and actions in ROS 2 that misbehave: `ros2_servers.py KIND DOMAIN`."""

import math
import os
import sys
import threading
import time
from typing import Any

import rclpy
from nav_msgs.srv import LoadMap
from rclpy.action import ActionServer
from rclpy.executors import MultiThreadedExecutor
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from tests.ros2_spinning import spin

kind, domain = sys.argv[1], int(sys.argv[2])
rclpy.init(domain_id=domain)
node = rclpy.create_node("hostile")


def silent(request: Any, response: Any) -> Any:
    time.sleep(3600)


def dying(request: Any, response: Any) -> Any:
    os._exit(1)


def large(request: Any, response: Any) -> Any:
    response.map.info.width = 1
    response.map.data = [0] * 20_000_000
    return response


def fine(request: Any, response: Any) -> Any:
    response.map.info.width = 7
    return response


def flood(publisher: Any, message: Any) -> None:
    def run() -> None:
        while True:
            publisher.publish(message)

    threading.Thread(target=run, daemon=True).start()


def turn_flood(goal: Any) -> Any:
    from robot_msgs.action import Turn

    feedback = Turn.Feedback()
    while True:
        for share in (0.5, math.nan, math.inf, -1.0, 1e300):
            feedback.share = share
            goal.publish_feedback(feedback)


def turn_vanish(goal: Any) -> Any:
    os._exit(1)


def turn_text(goal: Any) -> Any:
    from robot_msgs.action import Turn

    feedback = Turn.Feedback()
    feedback.said = "\x1b[2J" + "x" * 1_000_000
    for _ in range(50):
        goal.publish_feedback(feedback)
        time.sleep(0.02)
    goal.abort()
    return Turn.Result()


if kind == "other_type":
    node.create_service(Trigger, "/load_map", fine)
elif kind in ("silent", "dying", "large"):
    node.create_service(LoadMap, "/load_map", {"silent": silent, "dying": dying, "large": large}[kind])
elif kind == "two":
    node.create_service(LoadMap, "/load_map", fine)
    other = rclpy.create_node("other")
    other.create_service(LoadMap, "/load_map", fine)
elif kind == "states":
    flood(node.create_publisher(String, "/move_state", 1000), String(data="moving"))
elif kind == "states_of_another_type":
    flood(node.create_publisher(Float64, "/move_state", 1000), Float64())
elif kind.startswith("turn_"):
    from robot_msgs.action import Turn

    server = ActionServer(node, Turn, "/turn", globals()[kind])
print("ready", flush=True)
executor = MultiThreadedExecutor()
executor.add_node(node)
if kind == "two":
    executor.add_node(other)
spin(executor)
os._exit(0)  # Python would wait for a callback that is silent
