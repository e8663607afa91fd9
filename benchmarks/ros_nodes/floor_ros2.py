# pyright: basic, reportMissingImports=false
"""The least that a bridge into ROS 2 can do: one double from a multicast group, published as one known type.

floor_ros2.py TOPIC GROUP PORT
"""

import asyncio
import socket
import struct
import sys

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64


async def main() -> None:
    topic, group, port = sys.argv[1], sys.argv[2], int(sys.argv[3])
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 * 1024 * 1024)
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    receiver.bind((group, port))
    membership = socket.inet_aton(group) + socket.inet_aton("127.0.0.1")
    receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    receiver.setblocking(False)
    rclpy.init()
    node = rclpy.create_node("benchmark_floor")
    # What the bridge offers for a mirrored topic.
    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = node.create_publisher(Float64, topic, qos)
    unpack = struct.Struct("<d").unpack

    def drain() -> None:
        while True:
            try:
                datagram = receiver.recv(2048)
            except BlockingIOError:
                return
            publisher.publish(Float64(data=unpack(datagram)[0]))

    loop = asyncio.get_running_loop()
    loop.add_reader(receiver.fileno(), drain)
    print("ready", flush=True)
    await asyncio.to_thread(sys.stdin.read)
    loop.remove_reader(receiver.fileno())
    node.destroy_node()
    rclpy.shutdown()


asyncio.run(main())
