from __future__ import annotations

from collections.abc import Mapping

import pytest
from ua_bridges.ros import (
    SchemaInvalid,
    canonical_type_name,
    compact_definition,
    ros1_type_name,
    schema_from_definition,
    schema_from_ros2,
)
from ua_bridges.ros.leaves import leaves_of
from ua_bridges.ros.schema import MessageSchema

LASER_SCAN = """\
# Single scan; comments may hold float32 = signs
Header header            # timestamp = of the first ray
float32 angle_min        # start angle
float32[] ranges
string NAME=a # b
uint8 DEBUG=1

================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""

ROS2 = {
    "sensor_msgs/LaserScan": {"header": "std_msgs/Header", "angle_min": "float", "ranges": "sequence<float>"},
    "std_msgs/Header": {"stamp": "builtin_interfaces/Time", "frame_id": "string"},
    "builtin_interfaces/Time": {"sec": "int32", "nanosec": "uint32"},
}


def names(schema: MessageSchema) -> list[tuple[str, int, bool]]:
    return [(leaf.name, leaf.builtin, leaf.is_array) for leaf in leaves_of(schema)]


def test_same_type_of_both_ros_has_the_same_fields() -> None:
    ros1 = schema_from_definition("sensor_msgs/LaserScan", LASER_SCAN)
    ros2 = schema_from_ros2("sensor_msgs/msg/LaserScan", ROS2.__getitem__)
    assert names(ros1) == names(ros2)
    assert [name for name, _, _ in names(ros1)] == [
        "header.stamp.sec",
        "header.stamp.nanosec",
        "header.frame_id",
        "angle_min",
        "ranges",
    ]
    assert ros1.name == ros2.name == "sensor_msgs/LaserScan"


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("sequence<double>", ("float64", True, None, None, None)),
        ("sequence<double, 4>", ("float64", True, None, 4, None)),
        ("double[36]", ("float64", True, 36, None, None)),
        ("string<10>", ("string", False, None, None, 10)),
        ("wstring", ("wstring", False, None, None, None)),
        ("sequence<string<10>, 4>", ("string", True, None, 4, 10)),
        ("wstring<3>[2]", ("wstring", True, 2, None, 3)),
        ("octet", ("byte", False, None, None, None)),
        ("boolean", ("bool", False, None, None, None)),
        ("uint64", ("uint64", False, None, None, None)),
    ],
)
def test_ros2_type_strings(kind: str, expected: tuple[object, ...]) -> None:
    schema = schema_from_ros2("p/T", {"p/T": {"x": kind}}.__getitem__)
    (member,) = schema.members
    assert (member.type, member.array, member.length, member.bound, member.text_bound) == expected


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("int8 a", ("int8", False, None)),
        ("byte[] a", ("byte", True, None)),
        ("float64[9] a  # comment", ("float64", True, 9)),
        ("  string   a", ("string", False, None)),
    ],
)
def test_ros1_lines(line: str, expected: tuple[object, ...]) -> None:
    (member,) = schema_from_definition("p/T", line).members
    assert (member.type, member.array, member.length) == expected


def test_nested_types_of_the_same_package_need_no_package() -> None:
    schema = schema_from_definition(
        "p/T", "Part part\nq/Other other\n===\nMSG: p/Part\nint8 x\n===\nMSG: q/Other\nint8 y"
    )
    assert [leaf.name for leaf in leaves_of(schema)] == ["part.x", "other.y"]


def test_capital_letters_of_ros1_become_small_unless_they_tell_members_apart() -> None:
    info = schema_from_definition("sensor_msgs/CameraInfo", "float64[] D\nfloat64[9] K")
    assert [(member.name, member.attribute) for member in info.members] == [("d", "D"), ("k", "K")]
    both = schema_from_definition("p/T", "int8 a\nint8 A")
    assert [member.name for member in both.members] == ["a", "A"]


def test_standalone_times_of_ros1_are_the_messages_of_ros2() -> None:
    time = schema_from_definition("std_msgs/Time", "time data")
    assert (time.name, time.native) == ("builtin_interfaces/Time", "std_msgs/Time")
    assert [(m.name, m.attribute) for m in time.members] == [("sec", "data.secs"), ("nanosec", "data.nsecs")]


@pytest.mark.parametrize(
    ("name", "canonical", "ros1"),
    [
        ("std_msgs/msg/Float64", "std_msgs/Float64", "std_msgs/Float64"),
        ("std_msgs/Float64", "std_msgs/Float64", "std_msgs/Float64"),
        ("std_msgs/Time", "builtin_interfaces/Time", "std_msgs/Time"),
        ("builtin_interfaces/msg/Duration", "builtin_interfaces/Duration", "std_msgs/Duration"),
        ("roslib/Header", "std_msgs/Header", "std_msgs/Header"),
    ],
)
def test_type_names(name: str, canonical: str, ros1: str) -> None:
    assert canonical_type_name(name) == canonical
    assert ros1_type_name(canonical) == ros1


@pytest.mark.parametrize(
    ("definition", "reason"),
    [
        ("p/T inner", "p/T contains itself"),
        ("Part part", "the definition of p/Part is missing"),
        ("float64", "'float64' is not a member"),
        ("float64 __class__", "is not a member"),
        ("float64 a.b", "is not a member"),
        ("float64[x] a", "is not a member"),
        ("int8 a\n=====\nfloat64 b", "expected `MSG: pkg/Name`"),
        ("\n".join(f"int8 a{i}" for i in range(5000)), "more than 4096 members"),
    ],
)
def test_definition_that_cannot_be_understood(definition: str, reason: str) -> None:
    with pytest.raises(SchemaInvalid, match=r"message type p/T: .*") as caught:
        schema_from_definition("p/T", definition)
    assert reason in str(caught.value)


def test_definition_that_doubles_with_each_type_is_refused() -> None:
    sections = ["B0 a\nB0 b"]
    sections += [f"MSG: p/B{i}\nB{i + 1} a\nB{i + 1} b" for i in range(40)]
    sections.append("MSG: p/B40\nint8 x")
    with pytest.raises(SchemaInvalid, match="more than 4096 members"):
        schema_from_definition("p/T", "\n====\n".join(sections))


@pytest.mark.parametrize(
    ("types", "reason"),
    [
        ({"p/T": {"a": "long double"}}, "has the type long double"),
        ({"p/T": {"a": "q/Absent"}}, "the field types of q/Absent are missing"),
        ({"p/T": {"a": "p/T"}}, "contains itself"),
        ({"p/T": {"a": "p/U", "a.x": "int8"}, "p/U": {"x": "int8"}}, "the same flat name"),
    ],
)
def test_ros2_types_without_flat_form(types: Mapping[str, Mapping[str, str]], reason: str) -> None:
    with pytest.raises(SchemaInvalid) as caught:
        leaves_of(schema_from_ros2("p/T", types.__getitem__))
    assert reason in str(caught.value)


def test_compact_definition_keeps_constants_and_types() -> None:
    assert compact_definition(LASER_SCAN).splitlines() == [
        "Header header",
        "float32 angle_min",
        "float32[] ranges",
        "string NAME=a # b",
        "uint8 DEBUG=1",
        "=" * 80,
        "MSG: std_msgs/Header",
        "uint32 seq",
        "time stamp",
        "string frame_id",
    ]
    assert compact_definition("# nothing\n") == ""
