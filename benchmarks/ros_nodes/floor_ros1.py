# pyright: basic, reportMissingImports=false
"""The least that a bridge from ROS 1 can do: one double of one known type, in bytes of its own, to a multicast group.

floor_ros1.py TOPIC GROUP PORT
"""

import asyncio
import socket
import struct
import sys

import rospy
from std_msgs.msg import Float64


async def main() -> None:
    topic, group, port = sys.argv[1], sys.argv[2], int(sys.argv[3])
    loop = asyncio.get_running_loop()
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
    pack, address = struct.Struct("<d").pack, (group, port)

    def send(value: float) -> None:
        sender.sendto(pack(value), address)

    def heard(message: Float64) -> None:
        loop.call_soon_threadsafe(send, message.data)

    rospy.init_node("benchmark_floor", disable_rosout=True, disable_signals=True)
    rospy.Subscriber(topic, Float64, heard, tcp_nodelay=True)
    print("ready", flush=True)
    await asyncio.to_thread(sys.stdin.read)
    rospy.signal_shutdown("done")


asyncio.run(main())
