# pyright: basic, reportMissingImports=false
"""The least that a bridge of ROS 1 can do: serialised messages as they are, to a group or from it.

load_floor_ros1.py out|in GROUP PORT STREAM=TOPIC...
"""

import io
import sys
import threading

import rospy
import sensor_msgs.msg

from benchmarks.ros_nodes.load_streams import ChunkReceiver, ChunkSender

TYPES = {"imu": "Imu", "scan": "LaserScan", "image": "Image", "cloud": "PointCloud2"}


class Serialised(rospy.AnyMsg):  # type: ignore[misc]  # rospy has no types
    """Bytes of a message that rospy sends as they are."""

    def __init__(self, content: object) -> None:
        super().__init__()
        self.content = content

    def serialize(self, buff: io.BytesIO) -> None:
        buff.write(self.content)  # type: ignore[arg-type]


def take(sender: ChunkSender, topics: list[list[str]]) -> None:
    sending = threading.Lock()

    def subscribe(number: int, topic: str) -> None:
        def heard(message: rospy.AnyMsg) -> None:
            with sending:
                sender.send(number, message._buff)

        rospy.Subscriber(topic, rospy.AnyMsg, heard, buff_size=1 << 20, tcp_nodelay=True)

    for number, (_, topic) in enumerate(topics):
        subscribe(number, topic)


def publish(receiver: ChunkReceiver, topics: list[list[str]]) -> None:
    publishers = []
    for stream, topic in topics:
        known = getattr(sensor_msgs.msg, TYPES[stream])
        raw = type(
            f"Raw{stream}", (Serialised,), {name: getattr(known, name) for name in ("_type", "_md5sum", "_full_text")}
        )
        publishers.append((raw, rospy.Publisher(topic, raw, queue_size=50, tcp_nodelay=True)))

    def work() -> None:
        while True:
            number, content = receiver.receive()
            raw, publisher = publishers[number]
            publisher.publish(raw(content))

    threading.Thread(target=work, daemon=True).start()


def main() -> None:
    way, group, port, *rest = sys.argv[1:]
    topics = [each.split("=") for each in rest]
    rospy.init_node(f"load_floor_{way}", disable_rosout=True, disable_signals=True)
    if way == "out":
        take(ChunkSender(group, int(port)), topics)
    else:
        publish(ChunkReceiver(group, int(port)), topics)
    print("ready", flush=True)
    sys.stdin.read()
    rospy.signal_shutdown("done")


main()
