# pyright: basic, reportMissingImports=false
"""The robot of the ROS benchmarks: a rospy node that publishes the monotonic clock on command.

    publisher_ros1.py TOPIC...

stdin: `TOPIC RATE COUNT`; stdout: `ready`, then `done` after each. `TOPIC` alone: `links N`.
"""

import sys
import time

import rospy
from std_msgs.msg import Float64


def publish(publisher: rospy.Publisher, rate: float, count: int) -> None:
    period = 1.0 / rate
    due = time.monotonic()
    message = Float64()
    for _ in range(count):
        left = due - time.monotonic()
        if left > 0:
            time.sleep(left)
        message.data = time.monotonic()
        publisher.publish(message)
        due += period


def main() -> None:
    rospy.init_node("benchmark_publisher", disable_rosout=True, disable_signals=True)
    publishers = {topic: rospy.Publisher(topic, Float64, queue_size=10_000, tcp_nodelay=True) for topic in sys.argv[1:]}
    print("ready", flush=True)
    for line in sys.stdin:
        topic, *numbers = line.split()
        if not numbers:
            print(f"links {publishers[topic].get_num_connections()}", flush=True)
            continue
        publish(publishers[topic], float(numbers[0]), int(numbers[1]))
        print("done", flush=True)
    rospy.signal_shutdown("done")


main()
