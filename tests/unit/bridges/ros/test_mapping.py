from __future__ import annotations

import math
from array import array
from types import SimpleNamespace as Message
from typing import Any

import pytest
from ua_bridges.ros.mapping import MappedSource, cast_scalar, compile_path
from ua_bridges.ros.topic_mapping import TopicMapping

from ua_fleet.config.schema import DataSetConfig, FieldConfig, ScalarType
from ua_fleet.endpoint.own_time import own_time
from ua_fleet.values import BuiltinType, StatusCode, Variant, ticks_from_unix_ns

NAN = math.nan


def bad(status: int) -> Variant:
    return Variant(BuiltinType.STATUS_CODE, status)


def source(**fields: FieldConfig) -> MappedSource:
    mapping = TopicMapping(topic="/battery_state", type="sensor_msgs/msg/BatteryState")
    return MappedSource(DataSetConfig(fields=fields, source=mapping), "Battery")


def single(value: Any, kind: ScalarType, *, array: bool = False, path: str | None = None) -> tuple[Any, str]:
    mapping = TopicMapping(topic="/t", type="std_msgs/Float64")
    mapped = MappedSource(DataSetConfig(type=kind, array=array, path=path, source=mapping), "Value")
    values, problems = mapped.read(Message(data=value), "std_msgs/Float64")
    return values[0], problems[0].reason if problems else ""


@pytest.mark.parametrize(
    ("value", "kind", "expected"),
    [
        (3.6, ScalarType.INT32, 4),
        (True, ScalarType.BYTE, 1),
        (1, ScalarType.BOOLEAN, True),
        (7, ScalarType.DOUBLE, 7.0),
        ("ready", ScalarType.STRING, "ready"),
        (b"\x01\x02", ScalarType.BYTE_STRING, b"\x01\x02"),
        ((1, 2), ScalarType.BYTE_STRING, b"\x01\x02"),
        (Message(secs=5, nsecs=7), ScalarType.DATETIME, ticks_from_unix_ns(5_000_000_007)),
        (Message(sec=5, nanosec=7), ScalarType.DATETIME, ticks_from_unix_ns(5_000_000_007)),
        (math.inf, ScalarType.FLOAT, math.inf),
    ],
)
def test_value_of_the_message_becomes_the_configured_type(value: Any, kind: ScalarType, expected: Any) -> None:
    result, reason = single(value, kind)
    assert (result, type(result), reason) == (expected, type(expected), "")


@pytest.mark.parametrize(
    ("value", "kind", "status"),
    [
        (NAN, ScalarType.INT32, StatusCode.BAD_OUT_OF_RANGE),
        (math.inf, ScalarType.UINT64, StatusCode.BAD_OUT_OF_RANGE),
        (256, ScalarType.BYTE, StatusCode.BAD_OUT_OF_RANGE),
        (-1, ScalarType.UINT16, StatusCode.BAD_OUT_OF_RANGE),
        (1e39, ScalarType.FLOAT, StatusCode.BAD_OUT_OF_RANGE),
        (2, ScalarType.BOOLEAN, StatusCode.BAD_TYPE_MISMATCH),
        ("1", ScalarType.INT32, StatusCode.BAD_TYPE_MISMATCH),
        (1, ScalarType.STRING, StatusCode.BAD_TYPE_MISMATCH),
        (1.0, ScalarType.DATETIME, StatusCode.BAD_TYPE_MISMATCH),
        ((1.0, 2.0), ScalarType.DOUBLE, StatusCode.BAD_TYPE_MISMATCH),
    ],
)
def test_value_that_does_not_fit_makes_the_field_bad(value: Any, kind: ScalarType, status: int) -> None:
    result, reason = single(value, kind)
    assert result == bad(status)
    assert reason


def test_array_fields() -> None:
    assert single([1, 2.6], ScalarType.INT16, array=True) == ((1, 3), "")
    assert single(b"\x01\x02", ScalarType.BYTE, array=True) == ((1, 2), "")
    assert single(1.0, ScalarType.INT16, array=True)[0] == bad(StatusCode.BAD_TYPE_MISMATCH)
    assert single([1, NAN], ScalarType.INT16, array=True)[0] == bad(StatusCode.BAD_OUT_OF_RANGE)


def test_array_of_rclpy_is_taken_as_a_whole_where_its_type_fits() -> None:
    image = array("B", bytes(range(256)) * 4000)  # each element by itself took a second for a megabyte
    began = own_time()
    assert single(image, ScalarType.BYTE_STRING) == (image.tobytes(), "")
    assert single(image, ScalarType.UINT16, array=True) == (tuple(image), "")
    assert own_time() - began < 0.3
    assert single(array("f", [0.5, 1.5]), ScalarType.DOUBLE, array=True) == ((0.5, 1.5), "")
    assert single(array("d", [1e300]), ScalarType.FLOAT, array=True)[1] == "1e+300 does not fit into Float"
    assert single(array("h", [-1]), ScalarType.UINT16, array=True)[1] == "-1 does not fit into UInt16"


def test_path_reaches_into_arrays_and_says_when_they_are_too_short() -> None:
    assert single([4.0, 5.0], ScalarType.DOUBLE, path="data[1]") == (5.0, "")
    result, reason = single([4.0], ScalarType.DOUBLE, path="data[1]")
    assert result == bad(StatusCode.BAD_OUT_OF_RANGE)
    assert "another length" in reason


@pytest.mark.parametrize("path", ["", "a..b", "a[x]", "a[-1]", "1a", "a b", "__class__", "a.__dict__"])
def test_path_that_cannot_be_followed_is_refused(path: str) -> None:
    with pytest.raises(ValueError, match="is not the path of a field"):
        compile_path(path)


def test_one_bad_field_leaves_the_others_good_and_its_reason_is_new_once() -> None:
    mapped = source(
        Percentage=FieldConfig(type=ScalarType.INT32, path="percentage"),
        Voltage=FieldConfig(type=ScalarType.FLOAT, path="voltage"),
    )
    kind = "sensor_msgs/BatteryState"
    values, problems = mapped.read(Message(percentage=NAN, voltage=12.5), kind)
    assert values == (bad(StatusCode.BAD_OUT_OF_RANGE), 12.5)
    assert [(problem.field, problem.new) for problem in problems] == [("Percentage", True)]
    _, problems = mapped.read(Message(percentage=NAN, voltage=12.5), kind)
    assert [problem.new for problem in problems] == [False]
    assert mapped.read(Message(percentage=80.0, voltage=12.5), kind) == ((80, 12.5), ())
    _, problems = mapped.read(Message(percentage=NAN, voltage=12.5), kind)
    assert [problem.new for problem in problems] == [True]


def test_reason_with_another_number_in_it_is_not_new() -> None:
    mapped = source(percentage=FieldConfig(type=ScalarType.BYTE))
    kind = "sensor_msgs/BatteryState"
    news = [mapped.read(Message(percentage=number), kind)[1][0].new for number in (300.0, 301.0, -4.5e7)]
    assert news == [True, False, False]


def test_topic_with_another_message_type_makes_every_field_bad() -> None:
    mapped = source(percentage=FieldConfig(type=ScalarType.DOUBLE))
    values, problems = mapped.read(Message(percentage=1.0), "std_msgs/String")
    assert values == (bad(StatusCode.BAD_TYPE_MISMATCH),)
    assert problems[0].reason == "the topic carries std_msgs/String, fleet.yaml says sensor_msgs/BatteryState"


def test_field_that_the_message_does_not_have() -> None:
    mapped = source(charge=FieldConfig(type=ScalarType.DOUBLE))
    values, problems = mapped.read(Message(), "sensor_msgs/BatteryState")
    assert values == (bad(StatusCode.BAD_CONFIGURATION_ERROR),)
    assert "correct `path`" in problems[0].reason


def test_cast_takes_every_configurable_type() -> None:
    for kind in ScalarType:
        sample: Any = {"String": "", "ByteString": b"", "DateTime": Message(secs=0, nsecs=0)}.get(kind.value, 1)
        cast_scalar(sample, kind)
