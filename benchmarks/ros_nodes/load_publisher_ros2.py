# pyright: basic, reportMissingImports=false
"""The robot of the load benchmark: an rclpy node that publishes serialised messages with the time in their headers.

load_publisher_ros2.py STREAM=TOPIC...
"""

import struct
import sys
import time

import rclpy
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

from benchmarks.ros_nodes.load_messages import message_of
from benchmarks.ros_nodes.load_streams import serve_publisher

STAMP = struct.Struct("<iI")


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("load_publisher")
    messages = {stream: message_of(stream) for stream in ("imu", "scan", "image", "cloud")}
    contents = {stream: bytearray(serialize_message(message)) for stream, message in messages.items()}
    publishers = {}
    for each in sys.argv[1:]:
        stream, topic = each.split("=")
        publishers[topic] = node.create_publisher(type(messages[stream]), topic, QoSProfile(depth=50))

    def publish(stream: str, topic: str) -> None:
        seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
        STAMP.pack_into(contents[stream], 4, seconds, nanoseconds)
        publishers[topic].publish(bytes(contents[stream]))

    serve_publisher(publish, lambda topic: publishers[topic].get_subscription_count())
    node.destroy_node()
    rclpy.shutdown()


main()
