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
from sensor_msgs.msg import Image, Imu, LaserScan, PointCloud2, PointField

from benchmarks.ros_nodes.load_streams import serve_publisher, sizes

STAMP = struct.Struct("<iI")


def message_of(stream: str) -> object:
    if stream == "imu":
        message: object = Imu()
    elif stream == "scan":
        message = LaserScan(ranges=[1.0 + i / 100 for i in range(sizes["ranges"])], intensities=[])
    elif stream == "image":
        message = Image(height=500, width=2000, encoding="mono8", step=2000, data=bytes(sizes["image"]))
    else:
        fields = [PointField(name=name, offset=4 * i, datatype=7, count=1) for i, name in enumerate("xyzi")]
        message = PointCloud2(
            height=1, width=sizes["cloud"] // 16, fields=fields, point_step=16, row_step=sizes["cloud"],
            data=bytes(sizes["cloud"]), is_dense=True,
        )  # fmt: skip
    message.header.frame_id = "base"  # type: ignore[attr-defined]
    return message


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
