"""How many objects rclpy would make of a serialized message, found out before it does. Pure.

Most messages are read by `ua_bridges.ros.codec`, which has its own bounds. The others rclpy reads: types with messages
in arrays that have arrays again, or with wide strings, and whatever comes in another encapsulation than plain
little-endian CDR. There a million empty elements in 12 MB keep the bridge's thread busy for many seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from struct import Struct
from typing import Final

from ua_bridges.ros.codec import MOST_OBJECTS
from ua_bridges.ros.errors import Unreadable
from ua_bridges.ros.schema import Member, MessageSchema

__all__ = ["MOST_NUMBERS", "Elements"]

MOST_NUMBERS: Final = 8_000_000
"""Numbers in the arrays of one message, those of bytes left out."""
_COUNTS: Final = {b"\0\0": Struct(">I"), b"\0\1": Struct("<I")}
"""By the encapsulations of plain CDR (DDSI-RTPS 10.5): big-endian, little-endian."""
_SIZES: Final = {
    **dict.fromkeys(("bool", "byte", "char", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float32"), 4),
    **dict.fromkeys(("int64", "uint64", "float64"), 8),
}
_TEXTS: Final = frozenset({"string", "wstring"})


def _members(schema: MessageSchema) -> Iterator[Member]:
    for member in schema.members:
        yield member
        if member.nested is not None:
            yield from _members(member.nested)


def _least(schema: MessageSchema) -> int:
    """Least bytes of a message; a structure of C has at least one."""
    return sum(_least_of(member) * (1 if not member.array else member.length or 0) for member in schema.members) or 1


def _least_of(member: Member) -> int:
    """Least bytes of one element."""
    return _least(member.nested) if member.nested is not None else _SIZES.get(member.type, 4)


def _fixed(schema: MessageSchema) -> int:
    """Objects of an empty message, itself included."""
    return 1 + sum(
        (_fixed(member.nested) if member.nested is not None else 1) * (1 if not member.array else member.length or 0)
        for member in schema.members
        if member.nested is not None or member.type in _TEXTS
    )


class Elements:
    """Counts for the messages of one type."""

    def __init__(self, schema: MessageSchema) -> None:
        self._schema = schema
        arrays = [member for member in _members(schema) if member.array and member.length is None]
        of_objects = [member for member in arrays if member.nested is not None or member.type in _TEXTS]
        each = [
            (_fixed(member.nested) if member.nested is not None else 1) / _least_of(member) for member in of_objects
        ]
        self._fixed, self._densest = _fixed(schema), max(each, default=0.0)
        self._can_be_walked = all(member.type != "wstring" for member in _members(schema))

    def check(self, content: bytes) -> None:
        """Raise Unreadable where rclpy would make more objects of a message than anybody needs.

        Most messages are too short for that, and are not looked at. What ends too early is left to rclpy.
        """
        size = len(content)
        if self._fixed + size * self._densest <= MOST_OBJECTS and size <= MOST_NUMBERS:
            return
        count = _COUNTS.get(content[:2])
        if count is None or not self._can_be_walked:
            raise Unreadable(self._schema.name, f"{size} bytes in an encoding whose elements cannot be counted")
        try:
            _Walk(content, count, self._schema.name).message(self._schema)
        except _Ended:
            return


class _Ended(Exception):
    """The bytes are over."""


class _Walk:
    """Goes over a message, and counts."""

    def __init__(self, content: bytes, count: Struct, name: str) -> None:
        self._content, self._count, self._name = content, count, name
        self._at = 4
        self._objects = self._numbers = 0

    def message(self, schema: MessageSchema) -> None:
        self._is_object()
        if not schema.members:
            self._skip(1, 1)
        for member in schema.members:
            count = 1
            if member.array:
                count = self._length() if member.length is None else member.length
            if member.nested is None and member.type not in _TEXTS:
                size = _SIZES[member.type]
                if count:
                    self._skip(size, size * count)
                if member.array and size > 1:
                    self._numbers += count
                    if self._numbers > MOST_NUMBERS:
                        raise Unreadable(self._name, f"a message of more than {MOST_NUMBERS} numbers")
                continue
            for _ in range(count):
                if member.nested is not None:
                    self.message(member.nested)
                else:
                    self._is_object()
                    self._skip(1, self._length())

    def _is_object(self) -> None:
        self._objects += 1
        if self._objects > MOST_OBJECTS:
            raise Unreadable(self._name, f"a message of more than {MOST_OBJECTS} elements")

    def _length(self) -> int:
        self._skip(4, 4)
        length: int = self._count.unpack_from(self._content, self._at - 4)[0]
        return length

    def _skip(self, alignment: int, size: int) -> None:
        self._at += -(self._at - 4) % alignment + size
        if self._at > len(self._content):
            raise _Ended
