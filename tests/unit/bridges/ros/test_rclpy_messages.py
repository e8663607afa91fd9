# pyright: basic, reportMissingImports=false
from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from typing import Any

import pytest
from ua_bridges.ros import compile_reader, compile_writer, fields_of, schema_from_ros2
from ua_bridges.ros.schema import MessageSchema

pytestmark = [
    pytest.mark.needs("ros2"),
    # rclpy's type support imports lark, which imports a deprecated module of the standard library.
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),
]

GOALS = '[{"goal_info":{"goal_id":{"uuid":"AAECAwQFBgcICQoLDA0ODw=="},"stamp":{"sec":1,"nanosec":2}},"status":4}]'


def make(name: str) -> Any:
    package, _, kind = name.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)()


def field_types(name: str) -> Mapping[str, str]:
    return type(make(name)).get_fields_and_field_types()  # type: ignore[no-any-return]  # rclpy has no types


def schema_of(name: str) -> MessageSchema:
    return schema_from_ros2(name, field_types)


def through_cdr(message: Any) -> Any:
    """The message as a subscriber gets it: encoded and decoded by rclpy's own code."""
    from rclpy.serialization import deserialize_message, serialize_message

    return deserialize_message(serialize_message(message), type(message))


def written(name: str, *values: Any) -> Any:
    schema, message = schema_of(name), make(name)
    compile_writer(schema, [field.name for field in fields_of(schema, name)], make)(message, values)
    return through_cdr(message)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("std_msgs/Bool", (True,)),
        ("std_msgs/Byte", (255,)),
        ("std_msgs/Char", (200,)),
        ("std_msgs/Int8", (-128,)),
        ("std_msgs/UInt8", (255,)),
        ("std_msgs/Int16", (-32768,)),
        ("std_msgs/UInt16", (65535,)),
        ("std_msgs/Int32", (-(2**31),)),
        ("std_msgs/UInt32", (2**32 - 1,)),
        ("std_msgs/Int64", (-(2**63),)),
        ("std_msgs/UInt64", (2**64 - 1,)),
        ("std_msgs/Float32", (1.5,)),
        ("std_msgs/Float64", (math.pi,)),
        ("std_msgs/String", ("Grüße",)),
        ("std_msgs/Empty", (True,)),
        ("std_msgs/ByteMultiArray", (("x",), (2,), (2,), 0, b"\x00\xff")),
        ("std_msgs/UInt8MultiArray", ((), (), (), 0, b"\x00\xff")),
        ("std_msgs/Int8MultiArray", ((), (), (), 0, (-1, 1))),
        ("std_msgs/Float64MultiArray", ((), (), (), 0, (1.0, math.inf))),
        ("builtin_interfaces/Time", (-5, 6)),
        ("geometry_msgs/Twist", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)),
        ("geometry_msgs/PoseWithCovariance", (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0, (0.5,) * 36)),
        ("geometry_msgs/Polygon", ((1.0, 2.0), (3.0, 4.0), (5.0, 6.0))),
        ("sensor_msgs/JointState", (5, 6, "base", ("a", "b"), (1.0, 2.0), (), (3.0,))),
        ("sensor_msgs/LaserScan", (5, 6, "laser", 0.0, 1.0, 0.5, 0.0, 0.0, 0.0, 10.0, (1.0, math.inf), ())),
        ("sensor_msgs/CompressedImage", (5, 6, "camera", "jpeg", b"\xff\xd8")),
        ("nav_msgs/OccupancyGrid", (5, 6, "map", 7, 8, 0.5, 2, 1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, (-1, 100))),
        ("unique_identifier_msgs/UUID", (bytes(range(16)),)),
        ("action_msgs/GoalStatusArray", (GOALS,)),
    ],
)
def test_values_come_back_out_of_a_message_that_rclpy_has_sent(name: str, values: tuple[Any, ...]) -> None:
    read = compile_reader(schema_of(name))(written(name, *values))
    assert read == values
    assert [type(value) for value in read] == [type(value) for value in values]
    for got, wanted in zip(read, values, strict=True):
        if isinstance(wanted, tuple):
            assert [type(value) for value in got] == [type(value) for value in wanted]


@pytest.mark.parametrize(
    "name",
    ["std_msgs/Header", "sensor_msgs/Imu", "sensor_msgs/PointCloud2", "nav_msgs/Path", "nav_msgs/Odometry",
     "sensor_msgs/BatteryState", "rcl_interfaces/ParameterEvent", "rcl_interfaces/ParameterDescriptor"],
)  # fmt: skip
def test_default_message_goes_through_unchanged(name: str) -> None:
    message = through_cdr(make(name))
    assert written(name, *compile_reader(schema_of(name))(message)) == message
