"""Descriptions of DataTypes that DataSetMetaData carries, and their bytes (OPC 10000-5 12.31 to 12.34).

StructureDescription     a structure, a structure with optional fields, or a union
EnumerationDescription   an enumeration or an option set
SimpleTypeDescription    a subtype of a built-in type
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from struct import Struct
from typing import Final, NamedTuple

from ua_fleet.values import BuiltinType, LocalizedText, NodeId, QualifiedName
from ua_fleet.wire.builtin import (
    decode_localized_text,
    decode_node_id,
    decode_qualified_name,
    decode_string,
    decode_uint32s,
    encode_length,
    encode_localized_text,
    encode_node_id,
    encode_number,
    encode_qualified_name,
    encode_string,
    encode_uint32s,
)
from ua_fleet.wire.cursor import Cursor

__all__ = [
    "SMALLEST_DESCRIPTION",
    "EnumerationDescription",
    "EnumerationField",
    "SimpleTypeDescription",
    "StructureDescription",
    "StructureField",
    "StructureType",
    "decode_enumeration",
    "decode_simple_type",
    "decode_structure",
    "encode_enumeration",
    "encode_simple_type",
    "encode_structure",
]

SMALLEST_DESCRIPTION: Final = 8
"""Bytes that a description of a data type takes at least: NodeId 2, QualifiedName 6."""

_INT64 = Struct("<q")


class StructureType(IntEnum):
    """StructureType (OPC 10000-3 8.49)."""

    STRUCTURE = 0
    WITH_OPTIONAL_FIELDS = 1
    UNION = 2
    WITH_SUBTYPED_VALUES = 3
    UNION_WITH_SUBTYPED_VALUES = 4


class StructureField(NamedTuple):
    """StructureField (OPC 10000-3 8.51)."""

    name: str
    data_type: NodeId
    value_rank: int = -1
    is_optional: bool = False
    """With subtyped values: whether a subtype may stand there."""
    description: LocalizedText = LocalizedText(None)
    array_dimensions: tuple[int, ...] = ()
    max_string_length: int = 0


class StructureDescription(NamedTuple):
    """StructureDescription with its StructureDefinition (OPC 10000-3 8.48)."""

    data_type: NodeId
    name: QualifiedName
    fields: tuple[StructureField, ...]
    structure_type: int = StructureType.STRUCTURE
    default_encoding: NodeId = NodeId(0, 0)
    """The NodeId of its Default Binary encoding."""
    base_data_type: NodeId = NodeId(0, 22)


class EnumerationField(NamedTuple):
    """EnumField (OPC 10000-3 8.52)."""

    value: int
    name: str
    display_name: LocalizedText = LocalizedText(None)
    description: LocalizedText = LocalizedText(None)


class EnumerationDescription(NamedTuple):
    """EnumDescription: an enumeration, or an option set whose built-in type is an unsigned integer."""

    data_type: NodeId
    name: QualifiedName
    fields: tuple[EnumerationField, ...]
    builtin_type: int = BuiltinType.INT32


class SimpleTypeDescription(NamedTuple):
    """SimpleTypeDescription: a subtype of a built-in type."""

    data_type: NodeId
    name: QualifiedName
    base_data_type: NodeId
    builtin_type: int


CountParts = Callable[[Cursor, int], int]
"""Reads how many parts follow, each of so many bytes at least, and refuses too many."""


def decode_structure(cursor: Cursor, count: CountParts) -> StructureDescription:
    """A StructureDescription."""
    data_type, name = decode_node_id(cursor), decode_qualified_name(cursor)
    encoding, base, kind = decode_node_id(cursor), decode_node_id(cursor), cursor.int32()
    fields = tuple([_decode_field(cursor) for _ in range(count(cursor, 1))])
    return StructureDescription(data_type, name, fields, kind, encoding, base)


def _decode_field(cursor: Cursor) -> StructureField:
    name, description, data_type = decode_string(cursor), decode_localized_text(cursor), decode_node_id(cursor)
    value_rank, dimensions, length = cursor.int32(), decode_uint32s(cursor), cursor.uint32()
    return StructureField(name or "", data_type, value_rank, bool(cursor.byte()), description, dimensions, length)


def decode_enumeration(cursor: Cursor, count: CountParts) -> EnumerationDescription:
    """An EnumDescription."""
    data_type, name = decode_node_id(cursor), decode_qualified_name(cursor)
    fields: list[EnumerationField] = []
    for _ in range(count(cursor, 1)):
        value: int = cursor.unpack(_INT64)[0]
        display_name, description = decode_localized_text(cursor), decode_localized_text(cursor)
        fields.append(EnumerationField(value, decode_string(cursor) or "", display_name, description))
    return EnumerationDescription(data_type, name, tuple(fields), cursor.byte())


def decode_simple_type(cursor: Cursor) -> SimpleTypeDescription:
    """A SimpleTypeDescription."""
    return SimpleTypeDescription(
        decode_node_id(cursor), decode_qualified_name(cursor), decode_node_id(cursor), cursor.byte()
    )


def encode_structure(out: bytearray, value: StructureDescription) -> None:
    """Append a StructureDescription."""
    encode_node_id(out, value.data_type)
    encode_qualified_name(out, value.name)
    encode_node_id(out, value.default_encoding)
    encode_node_id(out, value.base_data_type)
    encode_number(out, BuiltinType.INT32, value.structure_type)
    encode_length(out, len(value.fields))
    for field in value.fields:
        encode_string(out, field.name)
        encode_localized_text(out, field.description)
        encode_node_id(out, field.data_type)
        encode_number(out, BuiltinType.INT32, field.value_rank)
        encode_uint32s(out, field.array_dimensions)
        encode_number(out, BuiltinType.UINT32, field.max_string_length)
        encode_number(out, BuiltinType.BOOLEAN, field.is_optional)


def encode_enumeration(out: bytearray, value: EnumerationDescription) -> None:
    """Append an EnumDescription."""
    encode_node_id(out, value.data_type)
    encode_qualified_name(out, value.name)
    encode_length(out, len(value.fields))
    for field in value.fields:
        encode_number(out, BuiltinType.INT64, field.value)
        encode_localized_text(out, field.display_name)
        encode_localized_text(out, field.description)
        encode_string(out, field.name)
    encode_number(out, BuiltinType.BYTE, value.builtin_type)


def encode_simple_type(out: bytearray, value: SimpleTypeDescription) -> None:
    """Append a SimpleTypeDescription."""
    encode_node_id(out, value.data_type)
    encode_qualified_name(out, value.name)
    encode_node_id(out, value.base_data_type)
    encode_number(out, BuiltinType.BYTE, value.builtin_type)
