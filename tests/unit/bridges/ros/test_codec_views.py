"""Long arrays as views of a message: what is read, and what is written of them, is the same as with tuples."""

from __future__ import annotations

from array import array
from typing import Any

import pytest
from ua_bridges.ros.codec import CDR_LITTLE_ENDIAN, Decoder, Encoder, compile_decoder, compile_encoder
from ua_bridges.ros.errors import ConversionError, Unreadable
from ua_bridges.ros.leaves import leaves_of
from ua_bridges.ros.schema import MessageSchema, schema_from_definition, schema_from_ros2

TYPES = {
    "odd": "uint8",
    "ranges": "sequence<float>",
    "wide": "sequence<double>",
    "counts": "sequence<int16>",
    "data": "sequence<uint8>",
    "flags": "sequence<boolean>",
}
ROS1 = {
    "sequence<float>": "float32[]",
    "sequence<double>": "float64[]",
    "sequence<int16>": "int16[]",
    "sequence<uint8>": "uint8[]",
    "sequence<boolean>": "bool[]",
}
VALUES = (
    7,
    tuple(0.5 * n for n in range(1001)),
    tuple(0.25 * n for n in range(40)),
    tuple(range(33)),
    bytes(range(256)) * 32,
    (True, False) * 40,
)


def schemas() -> list[MessageSchema]:
    definition = "".join(f"{ROS1.get(kind, kind)} {name}\n" for name, kind in TYPES.items())
    return [schema_from_definition("p/T", definition), schema_from_ros2("p/T", {"p/T": TYPES}.__getitem__)]


def both(schema: MessageSchema, *, packed_arrays: bool) -> tuple[Decoder, Encoder]:
    decode = compile_decoder(schema, packed_arrays=packed_arrays)
    encode = compile_encoder(schema, [leaf.name for leaf in leaves_of(schema)], lambda _values: None)
    assert decode is not None
    assert encode is not None
    return decode, encode


def plain(value: Any) -> Any:
    """Bytes for a view of bytes, a tuple for a view of numbers."""
    if not isinstance(value, memoryview):
        return value
    return value.tobytes() if value.format == "B" else tuple(value.tolist())


@pytest.mark.parametrize("schema", schemas(), ids=["ros1", "ros2"])
def test_views_hold_what_tuples_hold_and_are_written_as_they(schema: MessageSchema) -> None:
    decode, encode = both(schema, packed_arrays=True)
    content = encode(VALUES)
    values = decode(content)
    assert [type(value) is memoryview for value in values] == [False, True, True, True, True, False]
    assert tuple(map(plain, values)) == both(schema, packed_arrays=False)[0](content) == VALUES
    assert encode(values) == content


@pytest.mark.parametrize("schema", schemas(), ids=["ros1", "ros2"])
def test_views_of_other_numbers_are_converted(schema: MessageSchema) -> None:
    _, encode = both(schema, packed_arrays=True)
    given = (7, memoryview(array("d", VALUES[1])), memoryview(array("f", VALUES[2])), memoryview(array("q", VALUES[3])))
    given = (*given, memoryview(array("h", list(VALUES[4]))), VALUES[5])  # type: ignore[assignment]
    assert encode(given) == encode(VALUES)


@pytest.mark.parametrize("schema", schemas(), ids=["ros1", "ros2"])
def test_a_view_of_what_does_not_fit_is_refused(schema: MessageSchema) -> None:
    _, encode = both(schema, packed_arrays=True)
    for place, wrong in ((3, array("i", [40_000] * 40)), (4, array("h", [256] * 40)), (5, array("b", [1] * 40))):
        with pytest.raises(ConversionError):
            encode((*VALUES[:place], memoryview(wrong), *VALUES[place + 1 :]))


@pytest.mark.parametrize("schema", schemas(), ids=["ros1", "ros2"])
def test_no_cut_message_is_read_as_a_shorter_one(schema: MessageSchema) -> None:
    decode, encode = both(schema, packed_arrays=True)
    content = encode(VALUES)
    for size in range(len(CDR_LITTLE_ENDIAN), len(content), 97):
        with pytest.raises(Unreadable):
            decode(content[:size])
