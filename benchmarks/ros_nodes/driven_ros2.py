# pyright: basic, reportMissingImports=false
"""The robot of the benchmark `teleoperation`: an rclpy node that notes when which speed comes.

    driven_ros2.py TOPIC...

stdout: `ready`; stdin: `TOPIC`, answered with a JSON list of pairs, the monotonic time and the speed, since it was last
asked.
"""

import json
import sys
import time
from functools import partial

import rclpy
from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile

from benchmarks.ros_nodes.spinning_ros2 import spinning


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("benchmark_driven")
    speeds: dict[str, list[tuple[float, float]]] = {topic: [] for topic in sys.argv[1:]}
    now = time.monotonic

    def heard(noted: list[tuple[float, float]], message: Twist) -> None:
        noted.append((now(), message.linear.x))

    for topic, noted in speeds.items():
        node.create_subscription(Twist, topic, partial(heard, noted), QoSProfile(depth=1000))
    with spinning(node):
        print("ready", flush=True)
        for line in sys.stdin:
            noted = speeds[line.strip()]
            taken = noted[:]
            del noted[: len(taken)]
            print(json.dumps(taken), flush=True)


main()
