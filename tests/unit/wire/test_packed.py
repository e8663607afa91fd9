"""Long arrays as views of the message's bytes: the same bytes go out, and the same elements come in."""

from __future__ import annotations

import math
from array import array
from typing import Any

import pytest

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import ARRAY, BuiltinType
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import DataSetMessage, FrameKind, NetworkMessage, PublisherIdType
from ua_fleet.wire.packed import FEWEST_VIEWED, LEAST_VIEWED_BYTES, LETTERS

NUMBERS = {kind: [float(n) if letter in "fd" else n for n in range(100)] for kind, letter in LETTERS.items()}


def frame(types: tuple[int, ...], values: tuple[Any, ...]) -> bytes:
    """A key frame, by the generic encoder."""
    part = DataSetMessage(7, FrameKind.KEY.value, types, values, 1, 2, None, 0, 3, 4)
    return Codec().encode(
        NetworkMessage(2, PublisherIdType.UINT16.value, writer_group_id=2, messages=(part,)),
    )


def read(codec: Codec, datagram: bytes) -> tuple[Any, ...]:
    """The values of a message whose layout is known by now."""
    codec.decode(datagram)
    codec.decode(datagram)
    message = codec.decode(datagram)
    assert isinstance(message, NetworkMessage)
    return message.messages[0].values


@pytest.mark.parametrize("kind", LETTERS, ids=lambda kind: BuiltinType(kind).name)
@pytest.mark.parametrize("before", [(), (BuiltinType.STRING,)], ids=["first", "later"])
def test_a_view_is_encoded_as_its_elements_are(kind: int, before: tuple[int, ...]) -> None:
    types = (*before, ARRAY | kind, BuiltinType.BYTE)
    elements = tuple(NUMBERS[kind])
    view = memoryview(array(LETTERS[kind], elements))
    leading = ("odd",) * len(before)
    expected = frame(types, (*leading, elements, 9))
    assert frame(types, (*leading, view, 9)) == expected
    plan = Codec().writer_plan(2, 2, 7, types, 3, 4)
    assert plan.encode(1, 2, 0, (*leading, view, 9)) == expected


@pytest.mark.parametrize("kind", LETTERS, ids=lambda kind: BuiltinType(kind).name)
def test_a_long_array_is_read_as_a_view_by_who_asks_for_it(kind: int) -> None:
    types = (BuiltinType.STRING, ARRAY | kind, BuiltinType.BYTE)
    elements = tuple(NUMBERS[kind])
    datagram = frame(types, ("odd", elements, 9))
    assert read(Codec(), datagram) == ("odd", elements, 9)
    text, view, octet = read(Codec(packed_arrays=True), datagram)
    assert type(view) is memoryview
    assert (text, tuple(view), view.format, octet) == ("odd", elements, LETTERS[kind], 9)
    assert frame(types, (text, view, octet)) == datagram


def test_short_arrays_booleans_and_short_byte_strings_are_no_views() -> None:
    types = (ARRAY | BuiltinType.DOUBLE, ARRAY | BuiltinType.BOOLEAN, BuiltinType.BYTE_STRING)
    values = ((0.5,) * (FEWEST_VIEWED - 1), (True,) * 100, b"x" * (LEAST_VIEWED_BYTES - 1))
    assert read(Codec(packed_arrays=True), frame(types, values)) == values


def test_a_long_byte_string_is_a_view_and_is_encoded_as_one() -> None:
    types, octets = (BuiltinType.INT32, BuiltinType.BYTE_STRING), b"x" * LEAST_VIEWED_BYTES
    datagram = frame(types, (1, octets))
    _, view = read(Codec(packed_arrays=True), datagram)
    assert type(view) is memoryview
    assert view == octets
    assert frame(types, (1, view)) == Codec().writer_plan(2, 2, 7, types, 3, 4).encode(1, 2, 0, (1, view)) == datagram


def test_bytes_that_are_no_number_stay_what_they_are() -> None:
    nan = bytes.fromhex("0100c07f") * FEWEST_VIEWED  # with a payload, which a float of Python may lose
    types = (ARRAY | BuiltinType.FLOAT,)
    datagram = frame(types, (memoryview(nan).cast("f"),))
    (view,) = read(Codec(packed_arrays=True), datagram)
    assert math.isnan(view[0])
    assert frame(types, (view,)) == datagram


@pytest.mark.parametrize("cut", [1, 4, 100, 399, 400])
def test_an_array_that_ends_before_its_last_element_is_refused(cut: int) -> None:
    types = (BuiltinType.BYTE, ARRAY | BuiltinType.FLOAT)
    codec, datagram = Codec(packed_arrays=True), frame((*types,), (1, tuple(NUMBERS[BuiltinType.FLOAT])))
    read(codec, datagram)
    with pytest.raises(RemoteWireError):
        codec.decode(datagram[:-cut])


def test_a_view_of_other_elements_is_refused() -> None:
    view = memoryview(array("f", [1.0] * 40))
    for types in [(ARRAY | BuiltinType.DOUBLE,), (BuiltinType.BYTE, ARRAY | BuiltinType.INT32)]:
        values = (0,) * (len(types) - 1)
        with pytest.raises(LocalWireError):
            Codec().writer_plan(2, 2, 7, types, 3, 4).encode(1, 2, 0, (*values, view))
    with pytest.raises(LocalWireError):
        frame((BuiltinType.BYTE_STRING,), (view,))
