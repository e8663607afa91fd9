"""What rclpy would be kept busy by for seconds is refused before; what robots send is not."""

from __future__ import annotations

import struct
import time
from random import Random

import pytest
from ua_bridges.ros.codec import MOST_OBJECTS
from ua_bridges.ros.errors import Unreadable
from ua_bridges.ros.schema import MessageSchema, schema_from_ros2
from ua_bridges.ros2.elements import MOST_NUMBERS, Elements

LITTLE, BIG = b"\0\1\0\0", b"\0\0\0\0"
TYPES = {
    "p/Cloud": {"x": "uint8", "points": "sequence<p/Point>", "channels": "sequence<p/Channel>"},
    "p/Point": {"x": "float", "y": "float", "z": "double"},
    "p/Channel": {"name": "string", "values": "sequence<float>"},
    "p/Wide": {"texts": "sequence<wstring>"},
    "p/Many": {"inner": "sequence<p/Empties>"},
    "p/Empties": {"all": "sequence<p/Empty>"},
    "p/Empty": {},
}


def schema(name: str) -> MessageSchema:
    return schema_from_ros2(name, TYPES.__getitem__)


class Cdr:
    """Writes plain CDR."""

    def __init__(self, order: str = "<") -> None:
        self.order, self.content = order, bytearray(LITTLE if order == "<" else BIG)

    def put(self, code: str, *values: float) -> None:
        for value in values:
            self.content += b"\0" * (-(len(self.content) - 4) % struct.calcsize(code))
            self.content += struct.pack(self.order + code, value)

    def text(self, text: bytes) -> None:
        self.put("I", len(text) + 1)
        self.content += text + b"\0"

    def cloud(self, points: int, channels: int, values: int) -> bytes:
        self.put("B", 7)
        self.put("I", points)
        for _ in range(points):
            self.put("f", 1.0, 2.0)
            self.put("d", 3.0)
        self.put("I", channels)
        for _ in range(channels):
            self.text(b"ab")
            self.put("I", values)
            self.put("f", *[0.5] * values)
        return bytes(self.content)


@pytest.mark.parametrize("order", ["<", ">"])
def test_elements_are_counted_where_they_stand(order: str) -> None:
    elements = Elements(schema("p/Cloud"))
    elements.check(Cdr(order).cloud(40_000, 3, 40_000))  # larger than what needs no look
    with pytest.raises(Unreadable, match=f"more than {MOST_OBJECTS} elements"):
        elements.check(Cdr(order).cloud(1000, MOST_OBJECTS // 2, 0))


def test_an_array_of_arrays_of_nothing_is_refused_soon() -> None:
    content = LITTLE + struct.pack("<II", 1, 1 << 30) + bytes(1 << 22)
    before = time.process_time()
    with pytest.raises(Unreadable, match="elements"):
        Elements(schema("p/Many")).check(content)
    assert time.process_time() - before < 5


def test_numbers_are_bounded_too() -> None:
    content = LITTLE + struct.pack("<IIII", 0, 0, 1, 1) + b"\0\0\0\0" + struct.pack("<I", MOST_NUMBERS + 1)
    with pytest.raises(Unreadable, match="numbers"):
        Elements(schema("p/Cloud")).check(content + bytes(4 * (MOST_NUMBERS + 1)))


@pytest.mark.parametrize(("name", "head"), [("p/Wide", LITTLE), ("p/Cloud", b"\0\7\0\0"), ("p/Cloud", b"")])
def test_what_cannot_be_counted_is_refused_where_it_is_long(name: str, head: bytes) -> None:
    elements = Elements(schema(name))
    elements.check(head + bytes(100_000))
    with pytest.raises(Unreadable, match="cannot be counted"):
        elements.check((head or b"\xff\xff") + bytes(2_000_000))


def test_any_bytes_end_the_walk() -> None:
    random, elements = Random(4), Elements(schema("p/Cloud"))
    good = Cdr().cloud(50_000, 2, 10)
    for _ in range(6):
        changed = bytearray(good)
        for _ in range(5):
            at = random.randrange(4, len(good))
            changed[at : at + 4] = random.randbytes(4)
        del changed[random.randrange(len(changed) // 2, len(changed)) :]
        try:
            elements.check(bytes(changed))
        except Unreadable:
            continue
