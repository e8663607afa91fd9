# pyright: basic, reportMissingImports=false
"""The robot of the load benchmark: a rospy node that publishes serialised messages with the time in their headers.

load_publisher_ros1.py STREAM=TOPIC...
"""

import io
import struct
import sys
import time

import rospy
from sensor_msgs.msg import Image, Imu, LaserScan, PointCloud2, PointField

from benchmarks.ros_nodes.load_streams import serve_publisher, sizes

STAMP = struct.Struct("<II")


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
