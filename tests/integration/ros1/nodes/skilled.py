# pyright: basic, reportMissingImports=false, reportAttributeAccessIssue=false
"""A robot for the tests of skills: a topic with a status, services, an action, and a program with the decorator.

Prints what it is told. Move (geometry_msgs/Twist on /move) ends by its value: linear.x 1 is done, 2 fails, 3 goes on
until it is halted by 0; 4 is done after a second, and says so twice. The goal of /count (actionlib/Test) is how many
tenths of a second it takes; 99 is refused, 98 fails, 96 takes until the process gets SIGUSR1. /hold
(std_srvs/SetBool) answers at once to true, and after two seconds to false; /fail (std_srvs/Trigger) raises an
exception; /no (std_srvs/Trigger) says that it did not.
"""

import signal
import threading
import time
from typing import Any

import actionlib
import rospy
from actionlib.msg import TestAction, TestFeedback, TestResult
from geometry_msgs.msg import Twist
from std_msgs.msg import String
from std_srvs.srv import SetBool, SetBoolResponse, Trigger, TriggerResponse
from ua_bridges.robot import Execution, Refused
from ua_bridges.robot.ros1 import Robot

from tests.saying import say

rospy.init_node("skilled", disable_rosout=True)
state = rospy.Publisher("/move_state", String, queue_size=10)


def told(*what: object) -> None:
    say("told:", *what)


def publish_state(*texts: str) -> None:
    for text in texts:
        state.publish(String(data=text))


def on_move(move: Any) -> None:
    told("move", move.linear.x, move.angular.z)
    publish_state("moving" if move.linear.x else "standing")
    if move.linear.x == 4.0:
        threading.Timer(1.0, publish_state, ["arrived", "arrived"]).start()
    elif move.linear.x in (1.0, 2.0):
        threading.Timer(0.2, publish_state, ["arrived" if move.linear.x == 1.0 else "stuck"]).start()


def on_hold(request: Any) -> Any:
    told("hold", request.data)
    if not request.data:
        time.sleep(2.0)
    return SetBoolResponse(success=True, message="held")


def on_fail(_request: Any) -> Any:
    told("fail")
    raise RuntimeError("the gripper is stuck")


def on_no(_request: Any) -> Any:
    told("no")
    return TriggerResponse(success=False, message="there is nothing to do")


def do_count(handle: Any, tenths: int) -> None:
    if tenths == 96:
        released.wait(60)
        tenths_left = 0
    else:
        tenths_left = tenths % 98 if tenths < 100 else tenths
    for step in range(tenths_left):
        if handle.get_goal_status().status == 6:
            handle.set_canceled(TestResult(result=step), "stopped")
            return
        handle.publish_feedback(TestFeedback(feedback=step))
        time.sleep(0.1)
    if tenths == 98:
        handle.set_aborted(TestResult(), "lost count")
    else:
        handle.set_succeeded(TestResult(result=tenths), "counted")


def on_goal(handle: Any) -> None:
    tenths = handle.get_goal().goal
    told("count", tenths, handle.get_goal_id().id)
    if tenths == 99:
        handle.set_rejected(None, "no way")
        return
    handle.set_accepted()
    threading.Thread(target=do_count, args=(handle, tenths), daemon=True).start()


def on_cancel(handle: Any) -> None:
    told("cancel", handle.get_goal_id().id)


released = threading.Event()
signal.signal(signal.SIGUSR1, lambda *_: released.set())
robot = Robot()


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


rospy.Subscriber("/move", Twist, on_move)
rospy.Service("/hold", SetBool, on_hold)
rospy.Service("/fail", Trigger, on_fail)
rospy.Service("/no", Trigger, on_no)
# A bridge on a slow machine needs longer to come back than the 5 s for which a server remembers ended goals.
rospy.set_param("/count/status_list_timeout", 60)
server = actionlib.ActionServer("/count", TestAction, on_goal, on_cancel, auto_start=False)
server.start()
say("ready")
rospy.spin()
