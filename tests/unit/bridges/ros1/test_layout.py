from __future__ import annotations

import struct
import time

import pytest
from ua_bridges.ros1.layout import MOST_NUMBERS, MOST_OBJECTS, TooMany, layout_of

LINE = "=" * 80


def definition(first: str, **others: str) -> str:
    return f"\n{LINE}\n".join([first, *(f"MSG: acme_msgs/{name}\n{text}" for name, text in others.items())]) + "\n"


def length(count: int) -> bytes:
    return struct.pack("<I", count)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (definition("A[] all", A=""), "without content"),
        (definition("A[] all", A="B b", B="int8[0] nothing"), "without content"),
        (definition("A[999999] all", A="B[999999] more", B="int8 x"), "fixed arrays"),
        (definition("A[999999] all", A=""), "fixed arrays"),
        (definition("A[1000] all", A="B[1000] more", B=""), "fixed arrays"),
        (definition("float64[999999] all"), "fixed arrays"),
        (definition("A a", **{f"A{'' if n == 0 else n}": f"A{n + 1} a" for n in range(40)}, A40="int8 x"), "deep"),
    ],
)
def test_type_that_could_make_objects_without_end_is_refused(text: str, why: str) -> None:
    with pytest.raises(TooMany, match=why):
        layout_of("acme_msgs/Thing", text)


@pytest.mark.parametrize(
    "text",
    [
        definition("A[] all", A="string name\nint8 x"),
        definition("uint8[999999] image"),
        definition("float64[36] covariance\nA[100] all", A="float64 x\nfloat64 y"),
        definition("Header header\nfloat64[] ranges").replace("\n\n", "\n")
        + f"{LINE}\nMSG: std_msgs/Header\nuint32 seq\n",
    ],
)
def test_usual_types_are_taken(text: str) -> None:
    layout_of("acme_msgs/Thing", text).check(b"")


def test_messages_of_too_many_elements_are_refused_before_they_are_built() -> None:
    points = layout_of("acme_msgs/Thing", definition("A[] all", A="int8 x"))
    started = time.process_time()
    points.check(length(MOST_OBJECTS - 1) + bytes(MOST_OBJECTS - 1))
    with pytest.raises(TooMany):
        points.check(length(30 << 20) + bytes(30 << 20))
    with pytest.raises(TooMany):
        points.check(length(0xFFFFFFFF) + bytes(MOST_OBJECTS))
    assert time.process_time() - started < 5
    texts = layout_of("acme_msgs/Thing", definition("string[] all"))
    with pytest.raises(TooMany):
        texts.check(length(MOST_OBJECTS + 1) + bytes(4 * (MOST_OBJECTS + 1)))
    nested = layout_of("acme_msgs/Thing", definition("A[] all", A="B[] more", B="int8 x"))
    with pytest.raises(TooMany):
        nested.check(length(1000) + (length(1000) + bytes(1000)) * 1000)
    numbers = layout_of("acme_msgs/Thing", definition("int8[] all\nA a", A="int8[] all"))
    with pytest.raises(TooMany):
        numbers.check(
            length(MOST_NUMBERS // 2 + 1)
            + bytes(MOST_NUMBERS // 2 + 1)
            + length(MOST_NUMBERS // 2)
            + bytes(MOST_NUMBERS // 2)
        )


def test_a_large_message_of_few_elements_is_taken() -> None:
    cloud = layout_of("acme_msgs/Cloud", definition("A[] fields\nuint8[] data\nstring name", A="string name\nint8 x"))
    fields = length(2) + (length(1) + b"x" + b"\1") * 2
    cloud.check(fields + length(20 << 20) + bytes(20 << 20) + length(1) + b"y")
    cloud.check(fields + length(20 << 20) + bytes(2 << 20))  # ends early: who reads it says so


def test_a_missing_or_doubled_part_of_a_definition_is_named() -> None:
    with pytest.raises(ValueError, match="acme_msgs/A is missing"):
        layout_of("acme_msgs/Thing", "A a\n")
    with pytest.raises(ValueError, match="twice"):
        layout_of("acme_msgs/Thing", definition("A a", A="int8 x") + f"{LINE}\nMSG: acme_msgs/A\nint16 x\n")
