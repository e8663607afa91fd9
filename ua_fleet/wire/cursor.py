"""The cursor: the one place that owns offsets into a peer's bytes, and checks each of them."""

from __future__ import annotations

from struct import Struct
from typing import Any, Final

from ua_fleet.errors import RemoteWireError
from ua_fleet.wire.causes import Cause

__all__ = ["DEEPEST_NESTING", "MOST_ELEMENTS", "BoundedCursor", "Cursor"]

DEEPEST_NESTING: Final = 16
"""Levels of nested values that we follow; OPC 10000-6 5.2.2.12 wants at least 4 and expects no more than 10."""

MOST_ELEMENTS: Final = 100_000
"""Elements that are decoded one by one, as Strings and structures are, that we follow in one message. A small one costs
a hundred times the memory of its bytes. 65,535 DataSetWriters, which is all there can be, are fewer."""

_UINT16 = Struct("<H")
_UINT32 = Struct("<I")
_INT32 = Struct("<i")


class Cursor:
    """Reads bytes from `position` up to `end`; each read is checked before anything is allocated for it."""

    __slots__ = ("data", "depth", "elements", "end", "position")

    def __init__(self, data: bytes, position: int = 0, end: int | None = None) -> None:
        self.data = data
        self.position = position
        self.end = len(data) if end is None else end
        self.depth = 0
        self.elements = 0

    @property
    def remaining(self) -> int:
        """How many bytes are left."""
        return self.end - self.position

    def _advance(self, size: int) -> int:
        start = self.position
        if size > self.end - start:
            raise RemoteWireError(Cause.TRUNCATED, f"{size} bytes needed, {self.end - start} left", start)
        self.position = start + size
        return start

    def take(self, size: int) -> bytes:
        """The next `size` bytes."""
        start = self._advance(size)
        return self.data[start : start + size]

    def unpack(self, layout: Struct) -> tuple[Any, ...]:
        """The next bytes as `layout` lays them out."""
        return layout.unpack_from(self.data, self._advance(layout.size))

    # Most of what is read are these; a call less for each makes that a fifth faster.

    def byte(self) -> int:
        """A Byte."""
        start = self.position
        if start >= self.end:
            return self._advance(1)  # raises
        self.position = start + 1
        return self.data[start]

    def uint16(self) -> int:
        """A UInt16."""
        value: int = _UINT16.unpack_from(self.data, self._advance(2))[0]
        return value

    def uint32(self) -> int:
        """A UInt32."""
        value: int = _UINT32.unpack_from(self.data, self._advance(4))[0]
        return value

    def int32(self) -> int:
        """An Int32."""
        start = self.position
        if start + 4 > self.end:
            return self._advance(4)  # raises
        self.position = start + 4
        value: int = _INT32.unpack_from(self.data, start)[0]
        return value

    def length(self, smallest: int) -> int | None:
        """An Int32 count of elements of at least `smallest` bytes each; None for null (OPC 10000-6 5.2.2.4, 5.2.5)."""
        count = self.int32()
        if count < 0:
            if count == -1:
                return None
            raise RemoteWireError(Cause.NEGATIVE_LENGTH, f"length {count}", self.position - 4)
        if count * smallest > self.end - self.position:
            raise RemoteWireError(
                Cause.LENGTH_BEYOND_END, f"{count} elements announced, {self.remaining} bytes left", self.position - 4
            )
        return count

    def count_elements(self, count: int, smallest: int) -> None:
        """Count elements that are decoded one by one, whose array was announced just now."""
        del smallest
        self.elements += count
        if self.elements > MOST_ELEMENTS:
            raise RemoteWireError(Cause.TOO_MANY, f"more than {MOST_ELEMENTS} elements", self.position - 4)

    def descend(self) -> None:
        """Enter a nested value; `ascend` leaves it."""
        self.depth += 1
        if self.depth > DEEPEST_NESTING:
            raise RemoteWireError(Cause.TOO_DEEP, f"more than {DEEPEST_NESTING} levels", self.position)

    def ascend(self) -> None:
        """Leave a nested value."""
        self.depth -= 1

    def expect_padding(self) -> None:
        """Consume what is left, which must be zeros (padding up to ConfiguredSize, OPC 10000-14 6.3.1.3.3)."""
        rest = self.data[self.position : self.end]
        if rest.strip(b"\0"):
            raise RemoteWireError(Cause.TRAILING_BYTES, f"{len(rest)} bytes behind the message", self.position)
        self.position = self.end


class BoundedCursor(Cursor):
    """Reads structures: the elements of all their arrays together are counted, of numbers too."""

    __slots__ = ()

    def length(self, smallest: int) -> int | None:
        """As Cursor.length; what takes only a byte, as in Strings, is not counted."""
        count = Cursor.length(self, smallest)
        if count and smallest > 1:
            Cursor.count_elements(self, count, smallest)
        return count

    def count_elements(self, count: int, smallest: int) -> None:
        """As Cursor.count_elements; `length` has counted larger ones."""
        if smallest == 1:
            super().count_elements(count, smallest)
