# pyright: basic, reportMissingImports=false
"""A ROS 2 node that does what a robot should not: `ros2_program.py KIND DOMAIN [NUMBER]`."""

import sys
import time

import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from tests.ros2_spinning import spin_node

kind, domain = sys.argv[1], int(sys.argv[2])
number = int(sys.argv[3]) if len(sys.argv) > 3 else 0

rclpy.init(domain_id=domain)
node = rclpy.create_node("hostile")
print("ready", flush=True)


def short_lived() -> None:
    """Topics of the bridge's own space that come and go, a few at a time."""
    for first in range(1000, 1000 + number, 20):
        publishers = [node.create_publisher(Float64, f"/ua_{domain}_2_{each}", 1) for each in range(first, first + 20)]
        time.sleep(0.25)
        for publisher in publishers:
            publisher.publish(Float64(data=1.0))
        time.sleep(0.05)
        for publisher in publishers:
            node.destroy_publisher(publisher)


def crowd() -> None:
    """Many topics of the bridge's own space at the same time, which go again."""
    publishers = [node.create_publisher(Float64, f"/ua_{domain}_2_{1000 + each}", 1) for each in range(number)]
    time.sleep(3)
    for publisher in publishers:
        publisher.publish(Float64(data=1.0))
    for publisher in publishers:
        node.destroy_publisher(publisher)


def counting() -> None:
    """Not hostile: how many topics the bridge listens to, again and again."""
    while "ua_bridge" not in node.get_node_names():
        time.sleep(0.1)
    while True:
        print("listens to", len(node.get_subscriber_names_and_types_by_node("ua_bridge", "/")), flush=True)
        time.sleep(0.5)


def changing() -> None:
    """A topic whose type changes all the time."""
    for turn in range(number):
        publisher = node.create_publisher((Float64, String)[turn % 2], f"/ua_{domain}_2_66", 1)
        time.sleep(0.15)
        node.destroy_publisher(publisher)


def rubbish() -> None:
    """Bytes that are no message of the topic's type: too short, lengths that cannot be, no UTF-8."""
    head = b"\x00\x01\x00\x00"
    number_of, text, names = (
        node.create_publisher(kind, f"/ua_{domain}_2_{each}", 10)
        for kind, each in ((Float64, 66), (String, 67), (JointState, 68))
    )
    time.sleep(2)
    for _ in range(number):
        for content in (b"", b"\x00", head, head + b"\x01"):
            number_of.publish(content)
        for content in (b"\xff\xff\xff\xff", b"\x04\x00\x00\x00\xff\xfe\xfd\x00", b"\x00\x00\x00\x00"):
            text.publish(head + content)
        names.publish(head + b"\0" * 12 + b"\xff\xff\xff\x7f" * 4)
        time.sleep(0.05)


def flooding() -> None:
    """As many messages as there can be."""
    publisher = node.create_publisher(Float64, f"/ua_{domain}_2_66", 1000)
    end = time.monotonic() + number
    while time.monotonic() < end:
        publisher.publish(Float64(data=time.monotonic()))


{
    "short_lived": short_lived,
    "crowd": crowd,
    "counting": counting,
    "changing": changing,
    "flooding": flooding,
    "rubbish": rubbish,
}[kind]()
print("done", flush=True)
spin_node(node)
