# pyright: basic, reportMissingImports=false
"""What genpy reads and writes is what we read and write, byte for byte, for every message type that is installed."""

from __future__ import annotations

import io
from pathlib import Path
from random import Random

import pytest

pytest.importorskip("rospy")

import std_msgs
from ua_bridges.ros.codec import compile_decoder, compile_encoder
from ua_bridges.ros.convert import compile_reader, compile_writer
from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.leaves import EMPTY_FIELD, leaves_of
from ua_bridges.ros1.classes import needed_type, type_from_definition

from tests.unit.bridges.ros.drawn import mutated, values_of

PACKAGES = ("std_msgs", "geometry_msgs", "sensor_msgs", "actionlib_msgs", "rosgraph_msgs")


def installed() -> list[str]:
    folder = Path(std_msgs.__file__).parent.parent
    files = [(package, file.stem[1:]) for package in PACKAGES for file in (folder / package / "msg").glob("_[A-Z]*.py")]
    return [f"{package}/{name}" for package, name in files]


def test_every_installed_type_both_ways() -> None:
    random, without = Random(7), set[str]()
    types = installed()
    for name in types:
        kind = needed_type(name)
        schema = kind.schema
        names = [leaf.name for leaf in leaves_of(schema)] or [EMPTY_FIELD]
        decode, encode = compile_decoder(schema), compile_encoder(schema, names, lambda _values: None)
        if decode is None or encode is None:
            without.add(name)
            continue
        for _ in range(20):
            values, message, theirs = values_of(schema, random), kind.cls(), io.BytesIO()
            compile_writer(schema, names, kind.make)(message, values)
            message.serialize(theirs)
            assert encode(values) == theirs.getvalue(), name
            assert decode(theirs.getvalue()) == compile_reader(schema)(message) == values, name
    assert without == {"sensor_msgs/MultiEchoLaserScan", "sensor_msgs/PointCloud"}
    assert len(types) > 80


def test_what_is_no_message_costs_an_error() -> None:
    random = Random(5)
    schema = needed_type("sensor_msgs/PointCloud2").schema
    names = [leaf.name for leaf in leaves_of(schema)]
    decode, encode = compile_decoder(schema), compile_encoder(schema, names, lambda _values: None)
    assert decode is not None
    assert encode is not None
    refused = 0
    for _ in range(5_000):
        try:
            decode(mutated(encode(values_of(schema, random)), random))
        except ConversionError:
            refused += 1
    assert refused > 500


def test_seconds_that_ros_2_cannot_hold_are_refused_by_their_name() -> None:
    decode = compile_decoder(needed_type("std_msgs/Header").schema)
    assert decode is not None
    with pytest.raises(ConversionError, match=r"field stamp\.sec"):
        decode(b"\0\0\0\0" + b"\xff\xff\xff\xff" + bytes(8))


def test_a_header_without_seq_is_read_as_it_is() -> None:
    text = "Header header\nint32 x\n" + "=" * 80 + "\nMSG: std_msgs/Header\ntime stamp\nstring frame_id\n"
    kind = type_from_definition("my_msgs/Odd", text)
    decode = compile_decoder(kind.schema)
    assert decode is not None
    message, theirs = kind.cls(), io.BytesIO()
    message.x = 7
    message.serialize(theirs)
    assert decode(theirs.getvalue()) == (0, 0, "", 7)
