# pyright: basic, reportMissingImports=false, reportPrivateImportUsage=false
"""A robot of ROS 2 that says a long text: `speaker.py TOPIC FILE`.

Publishes a `std_msgs/String` of so many characters as the file has a number, ten times a second and also what it has
later; it begins with markup and how many there are.
"""

import sys
import time
from pathlib import Path

import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String

topic, path = sys.argv[1], Path(sys.argv[2])

rclpy.init()
node = rclpy.create_node("speaker")
publisher = node.create_publisher(String, topic, QoSProfile(depth=1))
print("ready", flush=True)
while rclpy.ok():
    count = int(path.read_text())
    publisher.publish(String(data=f"<b>{count}</b>".ljust(count, "x")))
    time.sleep(0.1)
