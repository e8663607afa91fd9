# pyright: basic, reportMissingImports=false, reportPrivateImportUsage=false
"""A robot with an action server /turn (robot_msgs/Turn). Prints what it is told.

It refuses angles above 360, and aborts those below -360. For 360 it takes a second to decide.
A goal of 359 it does not cancel, and one of 358 takes 2.5 s to stop.
"""

import time
from typing import Any

import rclpy
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from robot_msgs.action import Turn

from tests.ros2_spinning import spin
from tests.saying import say

rclpy.init()
node = rclpy.create_node("turner")


def turn(goal: Any) -> Any:
    asked, result = goal.request, Turn.Result()
    say("told:", asked.angle, bytes(goal.goal_id.uuid).hex())
    began = time.monotonic()
    while (spent := time.monotonic() - began) < asked.seconds:
        if goal.is_cancel_requested:
            time.sleep(2.5 if asked.angle == 358 else 0.0)
            say("canceled")
            goal.canceled()
            return result
        goal.publish_feedback(Turn.Feedback(share=spent / asked.seconds))
        time.sleep(0.05)
    if asked.angle < -360:
        goal.abort()
        result.said = "dizzy"
        return result
    goal.succeed()
    result.reached = asked.angle
    return result


def decide(goal: Any) -> GoalResponse:
    if goal.angle == 360:
        say("decides")
        time.sleep(1.0)
    return GoalResponse.REJECT if goal.angle > 360 else GoalResponse.ACCEPT


def decide_to_cancel(goal: Any) -> CancelResponse:
    say("is to cancel")
    return CancelResponse.REJECT if goal.request.angle == 359 else CancelResponse.ACCEPT


server = ActionServer(
    node,
    Turn,
    "/turn",
    turn,
    goal_callback=decide,
    cancel_callback=decide_to_cancel,
    callback_group=ReentrantCallbackGroup(),
)
executor = MultiThreadedExecutor()
executor.add_node(node)
say("ready")
spin(executor)
