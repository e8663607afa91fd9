# pyright: basic, reportMissingImports=false
"""A ROS 1 robot whose own program offers the skill `work`; prints what it is told. Argument: id of the skill."""

import sys
import time
from typing import Any

import rospy
from ua_bridges.robot import Execution, Refused
from ua_bridges.robot.ros1 import Robot

from tests.saying import say

rospy.init_node("worker", disable_rosout=True)
robot = Robot()


@robot.skill(int(sys.argv[1]))
def work(execution: Execution, work: str, seconds: float) -> dict[str, Any]:
    if work == "refuse":
        raise Refused("the machine does not do that")
    say(f"told: {work}")
    if work == "fail":
        raise RuntimeError("the machine broke")
    end = time.monotonic() + (seconds if work != "never ends" else 1e6)
    while time.monotonic() < end:
        execution.progress(0.5, "working")
        execution.canceled.wait(0.05)
        execution.wait_if_suspended()
    return {"done": work, "seconds": seconds}


say("ready")
rospy.spin()
