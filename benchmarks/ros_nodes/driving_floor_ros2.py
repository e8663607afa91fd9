# pyright: basic, reportMissingImports=false
"""The floor of the benchmark `teleoperation`: a WebSocket whose numbers an rclpy publisher sends on, and nothing else.

    driving_floor_ros2.py TOPIC PORT

stdout: `ready` when it listens.
"""

import asyncio
import sys

import rclpy
from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile
from websockets.asyncio.server import ServerConnection, serve


async def main(topic: str, port: int) -> None:
    rclpy.init()
    node = rclpy.create_node("benchmark_driving_floor")
    publisher = node.create_publisher(Twist, topic, QoSProfile(depth=10))

    async def connected(socket: ServerConnection) -> None:
        twist = Twist()
        async for text in socket:
            twist.linear.x = float(text)
            publisher.publish(twist)

    async with serve(connected, "127.0.0.1", port, compression=None):
        print("ready", flush=True)
        await asyncio.Future()


asyncio.run(main(sys.argv[1], int(sys.argv[2])))
