# pyright: basic, reportMissingImports=false
"""The least that a bridge of ROS 2 can do: serialised messages as they are, to a group or from it, in one thread.

load_floor_ros2.py out|in GROUP PORT STREAM=TOPIC...
"""

import sys
import threading
from functools import partial
from typing import Any

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image, Imu, LaserScan, PointCloud2

from benchmarks.ros_nodes.load_streams import ChunkReceiver, ChunkSender

TYPES = {"imu": Imu, "scan": LaserScan, "image": Image, "cloud": PointCloud2}


def take(node: Any, sender: ChunkSender, topics: list[list[str]]) -> None:
    for number, (stream, topic) in enumerate(topics):
        node.create_subscription(TYPES[stream], topic, partial(sender.send, number), QoSProfile(depth=1000), raw=True)
    executor = EventsExecutor()
    executor.add_node(node)
    while True:
        executor.spin_once(timeout_sec=0.2)


def publish(node: Any, receiver: ChunkReceiver, topics: list[list[str]]) -> None:
    # What the bridge offers for a mirrored topic.
    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publishers = [node.create_publisher(TYPES[stream], topic, qos) for stream, topic in topics]
    while True:
        number, content = receiver.receive()
        publishers[number].publish(content)


def main() -> None:
    way, group, port, *rest = sys.argv[1:]
    topics = [each.split("=") for each in rest]
    rclpy.init()
    node = rclpy.create_node("load_floor")
    if way == "out":
        work = partial(take, node, ChunkSender(group, int(port)), topics)
    else:
        work = partial(publish, node, ChunkReceiver(group, int(port)), topics)
    threading.Thread(target=work, daemon=True).start()
    print("ready", flush=True)
    sys.stdin.read()


main()
