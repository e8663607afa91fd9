from __future__ import annotations

import pytest
from ua_bridges.ros import fields_of, ros_type_of, schema_from_definition, schema_from_ros2, std_type_for

from ua_fleet.pubsub.metadata import field_property, make_field
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType

B = BuiltinType


def described(definition: str) -> list[tuple[str, int, int]]:
    schema = schema_from_definition("p/T", definition)
    return [(field.name, field.builtin_type, field.value_rank) for field in fields_of(schema, "p/T")]


@pytest.mark.parametrize(
    ("kind", "builtin"),
    [
        ("bool", B.BOOLEAN),
        ("byte", B.BYTE),
        ("char", B.BYTE),
        ("int8", B.SBYTE),
        ("uint8", B.BYTE),
        ("int16", B.INT16),
        ("uint16", B.UINT16),
        ("int32", B.INT32),
        ("uint32", B.UINT32),
        ("int64", B.INT64),
        ("uint64", B.UINT64),
        ("float32", B.FLOAT),
        ("float64", B.DOUBLE),
        ("string", B.STRING),
    ],
)
def test_primitives(kind: str, builtin: BuiltinType) -> None:
    octets = kind in ("byte", "char", "uint8")
    array = (B.BYTE_STRING, -1) if octets else (builtin, 1)
    assert described(f"{kind} a\n{kind}[] b\n{kind}[3] c") == [("a", builtin, -1), ("b", *array), ("c", *array)]


def test_times_nested_messages_and_arrays_of_messages() -> None:
    definition = (
        "duration d\nPoint[] points\nPose[2] poses\nOther[] others\nNothing[] nothings\nNothing nothing\n"
        "===\nMSG: p/Point\nfloat32 x\nbyte b\n===\nMSG: p/Pose\nPoint position\nint8 n\n"
        "===\nMSG: p/Other\nint8 a\nint8[] list\n===\nMSG: p/Nothing\n"
    )
    assert described(definition) == [
        ("d.sec", B.INT32, -1),
        ("d.nanosec", B.UINT32, -1),
        ("points.x", B.FLOAT, 1),
        ("points.b", B.BYTE, 1),
        ("poses.position.x", B.FLOAT, 1),
        ("poses.position.b", B.BYTE, 1),
        ("poses.n", B.SBYTE, 1),
        ("others", B.STRING, -1),
        ("nothings", B.STRING, -1),
    ]


def test_empty_message_has_one_boolean() -> None:
    assert described("# nothing") == [("empty", B.BOOLEAN, -1)]


def test_first_field_tells_the_type_and_its_definition() -> None:
    schema = schema_from_definition("p/T", "int8 a # why\nint8 b")
    first, second = fields_of(schema, "p/T", "int8 a # why\nint8 b")
    assert field_property(first, "RosType") == "p/T"
    assert field_property(first, "RosDefinition") == "int8 a\nint8 b\n"
    assert second.properties == ()
    assert ros_type_of((first, second)) == ("p/T", "int8 a\nint8 b\n", ("a", "b"))


def test_type_of_ros2_data_has_no_definition() -> None:
    schema = schema_from_ros2("std_msgs/msg/Bool", {"std_msgs/Bool": {"data": "boolean"}}.__getitem__)
    assert ros_type_of(fields_of(schema, schema.name)) == ("std_msgs/Bool", None, ("data",))


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        (B.BOOLEAN, "std_msgs/Bool"),
        (B.SBYTE, "std_msgs/Int8"),
        (B.BYTE, "std_msgs/UInt8"),
        (B.INT64, "std_msgs/Int64"),
        (B.UINT16, "std_msgs/UInt16"),
        (B.FLOAT, "std_msgs/Float32"),
        (B.DOUBLE, "std_msgs/Float64"),
        (B.STRING, "std_msgs/String"),
        (B.DOUBLE | ARRAY, "std_msgs/Float64MultiArray"),
        (B.BYTE | ARRAY, "std_msgs/UInt8MultiArray"),
        (B.BYTE_STRING, "std_msgs/UInt8MultiArray"),
        (B.BYTE_STRING | ARRAY, None),
        (B.BOOLEAN | ARRAY, None),
        (B.STRING | ARRAY, None),
        (B.DATETIME, None),
        (B.GUID, None),
        (B.DOUBLE | ARRAY | DIMENSIONS, None),
    ],
)
def test_std_msgs_of_space_0(code: int, expected: str | None) -> None:
    assert std_type_for(code) == expected


def test_several_fields_without_ros_type_have_none() -> None:
    one, two = make_field("Value", B.DOUBLE), make_field("Other", B.DOUBLE)
    assert ros_type_of((one,)) == ("std_msgs/Float64", None, ("data",))
    assert ros_type_of((one, two)) is None
    assert ros_type_of(()) is None
