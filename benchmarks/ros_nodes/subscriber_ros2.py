# pyright: basic, reportMissingImports=false
"""The other robot of the ROS benchmarks: an rclpy node in an EventsExecutor that notes how old each message is.

    subscriber_ros2.py TOPIC...

stdout: `ready`; stdin: `TOPIC`, answered with a JSON list of the ages in microseconds since it was last asked.
"""

import json
import sys
import time
from functools import partial

import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from benchmarks.ros_nodes.spinning_ros2 import spinning


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("benchmark_subscriber")
    ages: dict[str, list[float]] = {topic: [] for topic in sys.argv[1:]}
    now = time.monotonic

    def heard(noted: list[float], message: Float64) -> None:
        noted.append(now() - message.data)

    for topic, noted in ages.items():
        node.create_subscription(Float64, topic, partial(heard, noted), QoSProfile(depth=10_000))
    with spinning(node):
        print("ready", flush=True)
        for line in sys.stdin:
            noted = ages[line.strip()]
            taken = noted[:]
            del noted[: len(taken)]
            print(json.dumps([round(age * 1e6, 1) for age in taken]), flush=True)


main()
