# pyright: basic, reportMissingImports=false, reportAttributeAccessIssue=false
"""A ROS 1 arm with actionlib's own server, /work (actionlib/Test), and nothing of ua_fleet.

Prints `begun JOB`, `done JOB`, `refused JOB`.
"""

import threading
import time
from typing import Any

import actionlib
import rospy
from actionlib.msg import TestAction, TestResult

from tests.saying import say

rospy.init_node("arm", disable_rosout=True)


def work(handle: Any, job: int) -> None:
    time.sleep(job % 100 / 10)
    say(f"done {job}")
    handle.set_succeeded(TestResult(result=job))


def on_goal(handle: Any) -> None:
    job = handle.get_goal().goal
    if job < 0:
        say(f"refused {job}")
        handle.set_rejected(None, "the arm does not reach it")
        return
    say(f"begun {job}")
    handle.set_accepted()
    threading.Thread(target=work, args=(handle, job), daemon=True).start()


server = actionlib.ActionServer("/work", TestAction, on_goal, lambda handle: None, auto_start=False)
server.start()
say("ready")
rospy.spin()
