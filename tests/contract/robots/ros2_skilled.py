# pyright: basic, reportMissingImports=false
"""A ROS 2 robot whose own program offers the skill `work`; prints what it is told.

ros2_skilled.py SPACE SKILL_ID
"""

import sys
import time
from typing import Any

import rclpy
from ua_bridges.robot import Execution, Refused
from ua_bridges.robot.ros2 import Robot

from tests.ros2_spinning import spin_node
from tests.saying import say

rclpy.init()
node = rclpy.create_node("worker")
robot = Robot(node, space=int(sys.argv[1]))


@robot.skill(int(sys.argv[2]))
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
spin_node(node)
