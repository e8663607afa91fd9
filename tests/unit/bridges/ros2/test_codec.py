# pyright: basic, reportMissingImports=false
"""What rclpy reads and writes is what we read and write, for every message type that is installed."""

from __future__ import annotations

import importlib
import inspect
import tracemalloc
from random import Random

import pytest
from ua_bridges.ros.codec import CDR_LITTLE_ENDIAN, compile_decoder, compile_encoder
from ua_bridges.ros.convert import compile_reader, compile_writer
from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.leaves import EMPTY_FIELD, leaves_of
from ua_bridges.ros.serialized import flat_reader, stamp_reader
from ua_bridges.ros2.classes import MessageType, load_type, make

from tests.unit.bridges.ros.drawn import mutated, values_of

pytestmark = [
    pytest.mark.needs("ros2"),
    # rclpy's type support imports lark, which imports a deprecated module of the standard library.
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),
]

PACKAGES = (
    "std_msgs",
    "geometry_msgs",
    "sensor_msgs",
    "nav_msgs",
    "builtin_interfaces",
    "action_msgs",
    "rcl_interfaces",
)
WITHOUT = {
    "sensor_msgs/MultiEchoLaserScan",
    "sensor_msgs/PointCloud",
    "action_msgs/GoalStatusArray",
    "rcl_interfaces/ParameterEvent",
    "rcl_interfaces/ParameterEventDescriptors",
}
"""Messages in arrays that have arrays again: left to rclpy."""


def installed() -> list[str]:
    return [
        f"{package}/{name}"
        for package in PACKAGES
        for name, cls in vars(importlib.import_module(f"{package}.msg")).items()
        if inspect.isclass(cls) and hasattr(cls, "get_fields_and_field_types")
    ]


def names_of(kind: MessageType) -> list[str]:
    return [leaf.name for leaf in leaves_of(kind.schema)] or [EMPTY_FIELD]


def test_every_installed_type_both_ways() -> None:
    from rclpy.serialization import deserialize_message, serialize_message

    random, without = Random(7), set[str]()
    types = installed()
    for name in types:
        kind = load_type(name)
        fill = compile_writer(kind.schema, names_of(kind), make)
        decode = compile_decoder(kind.schema)
        encode = compile_encoder(kind.schema, names_of(kind), lambda _values: None)
        if decode is None or encode is None:
            without.add(name)
            continue
        for _ in range(20):
            values, message = values_of(kind.schema, random), kind.cls()
            fill(message, values)
            theirs = serialize_message(message)
            assert decode(theirs) == compile_reader(kind.schema)(message) == values, name
            assert deserialize_message(encode(values), kind.cls) == message, name
    assert without == WITHOUT
    assert len(types) > 90


def test_what_is_no_message_costs_an_error_and_no_memory() -> None:
    random, refused = Random(11), 0
    kinds = [
        load_type(f"sensor_msgs/{name}") for name in ("Imu", "JointState", "PointCloud2", "LaserScan", "CameraInfo")
    ]
    ways = [
        (
            kind,
            compile_encoder(kind.schema, names_of(kind), lambda _values: None),
            flat_reader(kind),
            stamp_reader(kind),
        )
        for kind in kinds
    ]
    tracemalloc.start()
    for number in range(10_000):
        kind, encode, read, stamp = ways[number % len(ways)]
        assert encode is not None
        assert stamp is not None
        content = CDR_LITTLE_ENDIAN + mutated(encode(values_of(kind.schema, random))[4:], random)
        try:
            stamp(content)
            read(content)
        except ConversionError:
            refused += 1
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert refused > 1_000
    assert peak < 4_000_000


@pytest.mark.parametrize(
    ("ros_type", "values", "culprit"),
    [
        ("std_msgs/Int32", (True,), "data"),
        ("std_msgs/Int32", (1 << 31,), "data"),
        ("std_msgs/Int32", (1.5,), "data"),
        ("std_msgs/Float32", (1e39,), "data"),
        ("std_msgs/Bool", (1,), "data"),
        ("std_msgs/String", ("a\0b",), "data"),
        ("std_msgs/String", (b"a",), "data"),
        ("geometry_msgs/Vector3", (1.0, "2", 3.0), "y"),
        ("sensor_msgs/NavSatFix", (0, 0, "", 0, 0, 0.0, 0.0, 0.0, (0.0,) * 8, 0), "position_covariance"),
        ("geometry_msgs/Polygon", ((1.0,), (1.0, 2.0), (1.0,)), "points"),
        ("std_msgs/Int32", (), r"\*"),
    ],
)
def test_what_does_not_fit_is_refused_by_its_name(ros_type: str, values: tuple[object, ...], culprit: str) -> None:
    kind = load_type(ros_type)
    fill, names = compile_writer(kind.schema, names_of(kind), make), names_of(kind)
    encode = compile_encoder(kind.schema, names, lambda values: fill(kind.cls(), values))
    assert encode is not None
    with pytest.raises(ConversionError, match=f"field {culprit}"):
        encode(values)


def test_integers_are_taken_for_floats_and_null_for_empty() -> None:
    kind = load_type("sensor_msgs/JointState")
    encode = compile_encoder(kind.schema, names_of(kind), lambda _values: None)
    assert encode is not None
    content = encode((1, 2, None, None, (1, 2), None, ()))
    assert flat_reader(kind)(content) == (1, 2, "", (), (1.0, 2.0), (), ())


def test_fields_in_another_order() -> None:
    kind = load_type("geometry_msgs/Vector3")
    encode = compile_encoder(kind.schema, ["z", "x", "y"], lambda _values: None)
    assert encode is not None
    assert flat_reader(kind)(encode((3.0, 1.0, 2.0))) == (1.0, 2.0, 3.0)


def test_long_arrays_that_nobody_wants_are_passed_over() -> None:
    kind = load_type("sensor_msgs/LaserScan")
    random = Random(3)
    values = values_of(kind.schema, random)
    encode = compile_encoder(kind.schema, names_of(kind), lambda _values: None)
    assert encode is not None
    read = dict(zip(names_of(kind), flat_reader(kind, frozenset({"range_max"}))(encode(values)), strict=True))
    assert read["ranges"] is None
    assert read["range_max"] == dict(zip(names_of(kind), values, strict=True))["range_max"]


def test_other_encapsulations_are_left_to_rclpy() -> None:
    kind = load_type("std_msgs/Int32")
    assert flat_reader(kind)(b"\0\0\0\0" + (5).to_bytes(4, "big")) == (5,)


def test_an_array_of_more_messages_or_texts_than_anybody_needs_is_refused_before_it_is_built() -> None:
    polygon = b"\0\1\0\0" + (250_001).to_bytes(4, "little") + bytes(250_001 * 12)
    names = b"\0\1\0\0" + bytes(8) + b"\1\0\0\0" + bytes(4) + (250_001).to_bytes(4, "little") + bytes(250_001 * 4)
    for ros_type, content in (("geometry_msgs/Polygon", polygon), ("sensor_msgs/JointState", names)):
        with pytest.raises(ConversionError, match="250001 elements"):
            flat_reader(load_type(ros_type))(content)
