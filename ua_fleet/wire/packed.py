"""Long arrays of numbers as the bytes that they have on the wire: views of them, with the letter that `struct` has.

What carries an array from one message into another needs none of its elements: a scan of 1,000 ranges costs 80 us on
its way through a bridge as a tuple of floats, and 2 us as a view. A view is a sequence, so who wants elements gets
them. ROS and UADP both have numbers in little-endian order, as the machine must have, too; on another one all are
tuples.
"""

from __future__ import annotations

import sys
from struct import error as StructError  # noqa: N812 - its name says nothing
from struct import unpack_from
from typing import Any, Final

from ua_fleet.values import BuiltinType

__all__ = ["LETTERS", "SIZES", "is_packed", "octets", "packed_array"]

_SIZES: Final = {"b": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8, "f": 4, "d": 8}
_IS_NATIVE: Final = sys.byteorder == "little" and all(
    memoryview(bytes(size)).cast(letter).itemsize == size  # type: ignore[call-overload]  # letters are no literals here
    for letter, size in _SIZES.items()
)
SIZES: Final = _SIZES if _IS_NATIVE else dict[str, int]()
"""Letters of the elements that an array may have as a view, with their bytes."""
_TYPES: Final[dict[int, str]] = {
    BuiltinType.SBYTE: "b",
    BuiltinType.INT16: "h",
    BuiltinType.UINT16: "H",
    BuiltinType.INT32: "i",
    BuiltinType.UINT32: "I",
    BuiltinType.INT64: "q",
    BuiltinType.UINT64: "Q",
    BuiltinType.FLOAT: "f",
    BuiltinType.DOUBLE: "d",
}
LETTERS: Final = {kind: letter for kind, letter in _TYPES.items() if letter in SIZES}
"""The letter of each built-in type whose arrays may be views."""
FEWEST_VIEWED: Final = 32
"""Elements of an array that is a view: a shorter tuple is made as fast."""
LEAST_VIEWED_BYTES: Final = 4096
"""Of a ByteString that is a view, which keeps its message in memory."""


def packed_array(data: bytes, start: int, count: int, letter: Any) -> Any:
    """So many elements: a view, a tuple where they are few. Raises struct.error where the bytes end before."""
    if count < FEWEST_VIEWED:
        return unpack_from(f"<{count}{letter}", data, start)
    end = start + count * SIZES[letter]
    if end > len(data):
        raise StructError(f"{count} elements do not fit into the bytes that are there")
    as_elements: Any = memoryview(data)[start:end].cast
    return as_elements(letter)


def octets(data: bytes, start: int, end: int) -> bytes | memoryview:
    """A ByteString: a view, a copy where it is short."""
    return data[start:end] if end - start < LEAST_VIEWED_BYTES else memoryview(data)[start:end]


def is_packed(value: object, letter: str | None) -> bool:
    """Whether a value is a view of such elements: `B` for the bytes of a ByteString."""
    return type(value) is memoryview and value.format == letter and value.ndim == 1 and value.c_contiguous
