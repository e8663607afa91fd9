# pyright: basic, reportMissingImports=false
"""The messages of the load benchmark, in ROS 1 and in ROS 2: their types have the same names and members there."""

from sensor_msgs.msg import Image, Imu, LaserScan, PointCloud2, PointField

from benchmarks.ros_nodes.load_streams import sizes

__all__ = ["message_of"]


def message_of(stream: str) -> object:
    """What a stream publishes, without its time."""
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
