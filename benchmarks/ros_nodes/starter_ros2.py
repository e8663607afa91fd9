# pyright: basic, reportMissingImports=false
"""The robot of the benchmark `skill_start`: an rclpy node that notes when it begins what it is asked for.

    starter_ros2.py SPACE

It offers the skill `go` (id 1010) by the decorator, begins `push` (id 1011) by a topic, and serves `/bare`. stdout:
`ready`; stdin: any line, answered with a JSON list of the monotonic times of all that began since it was last asked.
"""

import json
import sys
import time

import rclpy
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from ua_bridges.robot import Execution
from ua_bridges.robot.ros2 import Robot

from benchmarks.ros_nodes.spinning_ros2 import spinning


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("benchmark_starter")
    began: list[float] = []
    now = time.monotonic

    @Robot(node, space=int(sys.argv[1])).skill(1010, at_once=50)
    def go(execution: Execution, to: float) -> None:
        began.append(now())

    def push(message: Float64) -> None:
        began.append(now())

    def bare(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        began.append(now())
        return response

    node.create_subscription(Float64, "/push", push, 10)
    node.create_service(Trigger, "/bare", bare)
    with spinning(node):
        print("ready", flush=True)
        for _ in sys.stdin:
            taken = began[:]
            del began[: len(taken)]
            print(json.dumps(taken), flush=True)


main()
