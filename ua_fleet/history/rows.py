"""One value of the past, and the StatusCodes that history has beside those of values (OPC 10000-4 7.38)."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from enum import IntFlag
from itertools import islice
from typing import Any, Final, NamedTuple, Protocol, cast

from ua_fleet.values import TICKS_PER_SECOND, BuiltinType
from ua_fleet.wire.builtin import FIXED

__all__ = [
    "BAD",
    "BAD_BOUND_NOT_FOUND",
    "BAD_DATA_LOST",
    "BAD_NO_DATA",
    "EARLIEST",
    "LATEST",
    "MOST_READ_BYTES",
    "TICKS_PER_MS",
    "UNCERTAIN_DATA_SUB_NORMAL",
    "HistoryBits",
    "ListSeries",
    "Row",
    "Rows",
    "Series",
    "is_number",
    "value_bytes",
    "with_bits",
]

BAD: Final = 0x8000_0000
UNCERTAIN_DATA_SUB_NORMAL: Final = 0x40A4_0000
BAD_NO_DATA: Final = 0x809B_0000
"""No value: nothing was recorded here yet."""
BAD_DATA_LOST: Final = 0x809D_0000
"""From here on values are missing: the server did not run, or its store was away for too long."""
BAD_BOUND_NOT_FOUND: Final = 0x80D7_0000

EARLIEST: Final = 0
LATEST: Final = 0x7FFF_FFFF_FFFF_FFFF
TICKS_PER_MS: Final = TICKS_PER_SECOND // 1000

MOST_READ_BYTES: Final = 64_000_000
"""What values that are read at once take in memory, beside those of a fixed size."""
_ELEMENT_BYTES: Final = 40
"""Of an element of an array."""
_ARRAYS: Final = (tuple, list)

_IS_DATA_VALUE: Final = 0x0400
"""InfoType DataValue: the bits below say something (OPC 10000-4 7.38.1)."""


class HistoryBits(IntFlag):
    """What a StatusCode says of where a value of history comes from (OPC 10000-4 table 179)."""

    RAW = 0
    CALCULATED = 1
    INTERPOLATED = 2
    PARTIAL = 4
    EXTRA_DATA = 8
    MULTI_VALUE = 16


class Row(NamedTuple):
    """A value at a time."""

    time: int
    """SourceTimestamp in ticks."""
    status: int
    type: int
    """Type code of the value; 0 where there is none."""
    value: Any


def value_bytes(value: Any) -> int:
    """What a value takes in memory beyond what a number does, about."""
    if isinstance(value, bytes | bytearray):
        return len(value)
    if isinstance(value, memoryview):
        return value.nbytes
    if isinstance(value, str):
        return 4 * len(value)
    if isinstance(value, tuple | list):
        elements = cast("Sequence[Any]", value)
        # An array has elements of one type: a million numbers are not looked at one by one. A named tuple is no array.
        if elements and type(elements) in _ARRAYS and isinstance(elements[0], int | float):
            return _ELEMENT_BYTES * len(elements)
        return sum(_ELEMENT_BYTES + value_bytes(each) for each in elements)
    return 0


class Rows(list[Row]):
    """Rows as they are found, up to a number of them and of the bytes that their values take.

    The row with which the bytes are too many is the last one. Two are taken in any case: who goes on from the last one
    that he had, and finds it again, comes forward.
    """

    __slots__ = ("_left", "_most", "is_cut")

    def __init__(self, most: int, most_bytes: int = MOST_READ_BYTES) -> None:
        """Have room for so much."""
        super().__init__()
        self._most, self._left = most, most_bytes
        self.is_cut = False
        """Whether it is for their bytes that there are no more of them."""

    @property
    def room(self) -> int:
        """How many more are taken."""
        return 0 if self.is_cut else max(0, self._most - len(self))

    @property
    def room_bytes(self) -> int:
        """How many bytes more of values are taken, but where only one row is here."""
        return max(0, self._left)

    def take(self, rows: Iterable[Row]) -> None:
        """Add rows as far as there is room."""
        for row in islice(rows, self.room):
            self.append(row)
            if row.type not in FIXED:
                self._left -= value_bytes(row.value)
            if self._left <= 0 and len(self) > 1:
                self.is_cut = True
                return

    def take_numbers(self, rows: Sequence[Row]) -> None:
        """Add rows whose values have a fixed size, or that have none."""
        self += rows if len(rows) <= self.room else rows[: self.room]


class Series(Protocol):
    """The rows of one node."""

    def between(
        self, first: int, last: int, most: int, *, backward: bool = False, most_bytes: int = MOST_READ_BYTES
    ) -> Rows:
        """The rows of times from `first` to `last`, both included, at most so many: the earliest ones in their order,
        or, `backward`, the latest ones, the last one first. They are fewer where they take so many bytes.
        """
        ...


class ListSeries:
    """Such rows in memory."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self._rows = sorted(rows)
        self._times = [row.time for row in self._rows]

    def between(
        self, first: int, last: int, most: int, *, backward: bool = False, most_bytes: int = MOST_READ_BYTES
    ) -> Rows:
        """As the protocol says."""
        within = self._rows[bisect_left(self._times, first) : bisect_right(self._times, last)]
        found = Rows(most, most_bytes)
        found.take(reversed(within) if backward else within)
        return found


_NUMBERS: Final = frozenset(range(BuiltinType.SBYTE, BuiltinType.DOUBLE + 1))


def is_number(type_code: int) -> bool:
    """Whether values of a type can be calculated with: no Boolean, no text, no array."""
    return type_code in _NUMBERS


def with_bits(status: int, bits: int) -> int:
    """A StatusCode with what it says of the value's origin."""
    return status | _IS_DATA_VALUE | bits if bits else status
