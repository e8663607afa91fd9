# pyright: basic, reportMissingImports=false
"""The other robot of the load benchmark: an rclpy node that takes serialised messages.

load_subscriber_ros2.py STREAM=TOPIC...
"""

import struct
import sys
from functools import partial

import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, Imu, LaserScan, PointCloud2

from benchmarks.ros_nodes.load_streams import Arrivals
from benchmarks.ros_nodes.spinning_ros2 import spinning

TYPES = {"imu": Imu, "scan": LaserScan, "image": Image, "cloud": PointCloud2}


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("load_subscriber")
    arrivals = Arrivals(struct.Struct("<iI"), 4)
    for each in sys.argv[1:]:
        stream, topic = each.split("=")
        node.create_subscription(TYPES[stream], topic, partial(arrivals.heard, topic), QoSProfile(depth=50), raw=True)
    with spinning(node):
        arrivals.serve()


main()
