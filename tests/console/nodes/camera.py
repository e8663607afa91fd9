# pyright: basic, reportMissingImports=false, reportPrivateImportUsage=false
"""A stock camera of ROS 2: publishes what a file says as `sensor_msgs/Image`, also what it says later.

    camera.py TOPIC FILE [HZ]

The file has a line: ENCODING WIDTH HEIGHT, and points in hexadecimal that share the width, as `rgb8 40 30 ff0000
0000ff`. Each line of the picture has a byte more than its points, as cameras have that align theirs.
"""

import sys
import time
from array import array
from pathlib import Path

import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image

topic, path, hertz = sys.argv[1], Path(sys.argv[2]), float(sys.argv[3]) if len(sys.argv) > 3 else 10.0


def picture(said: str) -> Image:
    encoding, width, height, *points = said.split()
    message = Image(encoding=encoding, width=int(width), height=int(height))
    line = b"".join(bytes.fromhex(point) * (message.width // len(points)) for point in points) + b"\0"
    message.step = len(line)
    message.data = array("B", line * message.height)
    return message


rclpy.init()
node = rclpy.create_node("camera")
publisher = node.create_publisher(Image, topic, qos_profile_sensor_data)
print("ready", flush=True)
said, message = "", Image()
while rclpy.ok():
    if (now := path.read_text()) != said:
        said, message = now, picture(now)
    message.header.stamp = node.get_clock().now().to_msg()
    publisher.publish(message)
    time.sleep(1 / hertz)
