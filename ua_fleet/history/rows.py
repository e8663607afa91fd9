"""One value of the past, and the StatusCodes that history has beside those of values (OPC 10000-4 7.38)."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from enum import IntFlag
from typing import Any, Final, NamedTuple, Protocol

from ua_fleet.values import TICKS_PER_SECOND, BuiltinType

__all__ = [
    "BAD",
    "BAD_BOUND_NOT_FOUND",
    "BAD_DATA_LOST",
    "BAD_NO_DATA",
    "EARLIEST",
    "LATEST",
    "TICKS_PER_MS",
    "UNCERTAIN_DATA_SUB_NORMAL",
    "HistoryBits",
    "ListSeries",
    "Row",
    "Series",
    "is_number",
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


class Series(Protocol):
    """The rows of one node."""

    def between(self, first: int, last: int, most: int, *, backward: bool = False) -> list[Row]:
        """The rows of times from `first` to `last`, both included, at most so many: the earliest ones in their order,
        or, `backward`, the latest ones, the last one first.
        """
        ...


class ListSeries:
    """Such rows in memory."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self._rows = sorted(rows)
        self._times = [row.time for row in self._rows]

    def between(self, first: int, last: int, most: int, *, backward: bool = False) -> list[Row]:
        """As the protocol says."""
        found = self._rows[bisect_left(self._times, first) : bisect_right(self._times, last)]
        return (found[::-1] if backward else found)[:most]


_NUMBERS: Final = frozenset(range(BuiltinType.SBYTE, BuiltinType.DOUBLE + 1))


def is_number(type_code: int) -> bool:
    """Whether values of a type can be calculated with: no Boolean, no text, no array."""
    return type_code in _NUMBERS


def with_bits(status: int, bits: int) -> int:
    """A StatusCode with what it says of the value's origin."""
    return status | _IS_DATA_VALUE | bits if bits else status
