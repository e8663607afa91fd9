"""Fields with the bytes that they have on the wire, so that they are packed once and parsed once.

The arguments of an Action are measured, journaled and sent; where they come they are measured, journaled and handed to
a driver. All of that needs either the values or the bytes that stand behind the FieldCount (OPC 10000-14 7.2.4.5.9):
Variants, one after the other.
"""

from __future__ import annotations

from typing import Any, Final, Self

from ua_fleet.values import ARRAY, BuiltinType
from ua_fleet.wire.builtin import FIXED
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.variant import decode_variant, encode_typed

__all__ = ["PackedFields", "keep_content", "pack_fields", "unpack_fields"]

_KEPT_TYPES: Final = frozenset({*FIXED, BuiltinType.STRING, BuiltinType.BYTE_STRING})
"""Built-in types of which, also in arrays, every value that is decoded can be encoded, into as many bytes."""


class PackedFields(tuple[Any, ...]):  # noqa: SLOT001 - a tuple's subclass can have no slots
    """The values of fields, with their types and their bytes as Variants. Equal to any tuple of the same values."""

    types: tuple[int, ...]
    content: bytes

    def __new__(cls, types: tuple[int, ...], values: tuple[Any, ...], content: bytes) -> Self:
        """Keep the bytes beside the values; nothing is checked."""
        packed = super().__new__(cls, values)
        packed.types, packed.content = types, content
        return packed


def pack_fields(types: tuple[int, ...], values: tuple[Any, ...]) -> PackedFields:
    """The values with their bytes; those that are packed already are as they are.

    Raises LocalWireError for values that do not fit their types.
    """
    if isinstance(values, PackedFields) and values.types == types:
        return values
    out = bytearray()
    for code, value in zip(types, values, strict=True):
        encode_typed(out, code, value)
    return PackedFields(types, values, bytes(out))


def unpack_fields(content: bytes) -> PackedFields:
    """The values that these bytes are; raises RemoteWireError where they are none."""
    cursor = Cursor(content)
    types: list[int] = []
    values: list[Any] = []
    while cursor.remaining:
        code, value = decode_variant(cursor)
        types.append(code)
        values.append(value)
    return PackedFields(tuple(types), tuple(values), content)


def keep_content(types: tuple[int, ...], values: tuple[Any, ...], content: bytes) -> tuple[Any, ...]:
    """Decoded values with the bytes that they were decoded from, where the same values have bytes of ours, as long.

    A type that is reserved has none; what is nested may have others.
    """
    if any(code & ~ARRAY not in _KEPT_TYPES for code in types):
        return values
    return PackedFields(types, values, content)
