# pyright: basic, reportMissingImports=false
"""The robot of the load benchmark: a rospy node that publishes serialised messages with the time in their headers.

load_publisher_ros1.py STREAM=TOPIC...
"""

import io
import struct
import sys
import time

import rospy

from benchmarks.ros_nodes.load_messages import message_of
from benchmarks.ros_nodes.load_streams import serve_publisher

STAMP = struct.Struct("<II")


class Serialised(rospy.AnyMsg):  # type: ignore[misc]  # rospy has no types
    """Bytes of a message that rospy sends as they are."""

    def __init__(self, content: bytes) -> None:
        super().__init__()
        self.content = content

    def serialize(self, buff: io.BytesIO) -> None:
        buff.write(self.content)


def main() -> None:
    rospy.init_node("load_publisher", disable_rosout=True, disable_signals=True)
    contents, publishers = {}, {}
    for each in sys.argv[1:]:
        stream, topic = each.split("=")
        message = message_of(stream)
        written = io.BytesIO()
        message.serialize(written)  # type: ignore[attr-defined]
        contents[stream] = bytearray(written.getvalue())
        raw = type(
            f"Raw{stream}",
            (Serialised,),
            {name: getattr(type(message), name) for name in ("_type", "_md5sum", "_full_text")},
        )
        publishers[topic] = raw, rospy.Publisher(topic, raw, queue_size=50, tcp_nodelay=True)

    def publish(stream: str, topic: str) -> None:
        seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
        STAMP.pack_into(contents[stream], 4, seconds, nanoseconds)
        raw, publisher = publishers[topic]
        publisher.publish(raw(bytes(contents[stream])))

    serve_publisher(publish, lambda topic: publishers[topic][1].get_num_connections())
    rospy.signal_shutdown("done")


main()
