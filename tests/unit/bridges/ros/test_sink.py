from __future__ import annotations

import math
from types import SimpleNamespace as Message
from typing import Any

import pytest
from ua_bridges.ros import ConversionError, compile_sink, schema_from_definition

from ua_fleet.values import ticks_from_unix_ns

DEFINITION = (
    "Header header\nTwist twist\nfloat64[] position\nfloat32[3] gains\nuint8[] raw\nbool on\nTwist[] path\n"
    "string[] names\n"
    "===\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    "===\nMSG: p/Twist\nVector3 linear\n===\nMSG: p/Vector3\nfloat64 x\nint16 y\n"
)
SCHEMA = schema_from_definition("p/Command", DEFINITION)


def blank() -> Message:
    return Message(header=Message(stamp=Message()), twist=Message(linear=Message(x=0.0, y=0)), on=False, raw=b"")


def written(path: str, value: Any) -> Message:
    message = blank()
    compile_sink(SCHEMA, [("Value", path)])(message, (value,))
    return message


def test_values_go_where_their_path_says() -> None:
    assert written("twist.linear.x", 1.5).twist.linear == Message(x=1.5, y=0)
    assert written("twist.linear.y", 2.0).twist.linear == Message(x=0.0, y=2)
    assert written("position", (1.0, 2.0)).position == [1.0, 2.0]
    assert written("raw", b"ab").raw == b"ab"
    assert written("on", True).on is True


def test_indexed_elements_make_one_array() -> None:
    assert written("position[2]", 4.0).position == [0.0, 0.0, 4.0]
    assert written("gains[1]", 4.0).gains == [0.0, 4.0, 0.0]
    assert written("names[1]", "b").names == ["", "b"]
    message = blank()
    compile_sink(SCHEMA, [("A", "position[1]"), ("B", "position[0]")])(message, (1.0, 2.0))
    assert message.position == [2.0, 1.0]


def test_date_time_goes_into_a_time() -> None:
    path = "header.stamp"
    stamp = written(path, ticks_from_unix_ns(5_000_000_700)).header.stamp
    assert (stamp.secs, stamp.nsecs) == (5, 700)
    with pytest.raises(ConversionError, match="field Value: the time does not fit"):
        written(path, 0)
    with pytest.raises(ConversionError, match="field Value: a float is not a DateTime"):
        written(path, 1.0)


def test_names_of_either_ros_are_known() -> None:
    assert written("header.stamp.sec", 5).header.stamp.secs == 5
    assert written("header.stamp.secs", 5).header.stamp.secs == 5


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("twist.angular.x", "p/Twist has no field 'angular'; correct `path`"),
        ("twist", "is no single value"),
        ("path", "is no single value"),
        ("path.linear", "'path' is no single message"),
        ("twist.linear.x.y", "'x' is no single message"),
        ("twist.linear.x[0]", "there is no array"),
        ("raw[0]", "one ByteString"),
        ("gains[3]", "the array has 3 elements"),
        ("", "not the path of a field"),
        ("twist..x", "not the path of a field"),
        ("__class__", "not the path of a field"),
    ],
)
def test_path_that_the_type_does_not_have(path: str, reason: str) -> None:
    with pytest.raises(ConversionError) as caught:
        compile_sink(SCHEMA, [("Value", path)])
    assert reason in str(caught.value)


def test_value_that_does_not_fit_leaves_the_message_as_it_was() -> None:
    message = blank()
    write = compile_sink(SCHEMA, [("X", "twist.linear.x"), ("Y", "twist.linear.y")])
    with pytest.raises(ConversionError, match="field Y: nan is not an integer"):
        write(message, (1.0, math.nan))
    assert message == blank()
    with pytest.raises(ConversionError, match=r"field gains\[1\]: a str is not a number"):
        written("gains[1]", "a")
    with pytest.raises(ConversionError, match="1 values for 2 fields"):
        write(message, (1.0,))
