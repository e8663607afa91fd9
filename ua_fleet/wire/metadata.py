"""DataSetMetaData as bytes (OPC 10000-14 6.2.3.2; its nested types OPC 10000-5 12.30 to 12.34)."""

from __future__ import annotations

from struct import Struct
from typing import Any, Final

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType, NodeId, QualifiedName
from ua_fleet.wire.builtin import (
    decode_guid,
    decode_localized_text,
    decode_node_id,
    decode_qualified_name,
    decode_string,
    decode_strings,
    decode_uint32s,
    encode_guid,
    encode_length,
    encode_localized_text,
    encode_node_id,
    encode_number,
    encode_qualified_name,
    encode_string,
    encode_strings,
    encode_uint32s,
)
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.descriptions import (
    SMALLEST_DESCRIPTION,
    decode_enumeration,
    decode_simple_type,
    decode_structure,
    encode_enumeration,
    encode_simple_type,
    encode_structure,
)
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, FieldMetaData
from ua_fleet.wire.variant import decode_variant, encode_typed

__all__ = ["MOST_DESCRIBED", "decode_metadata", "encode_metadata"]

SMALLEST_FIELD: Final = 43
SMALLEST_PROPERTY: Final = 7

MOST_DESCRIBED: Final = 2_000
"""Fields, their properties and what describes data types, together: 20,000 take half a second to read."""

_FLAGS_AND_TYPE = Struct("<HB")


def decode_metadata(cursor: Cursor) -> DataSetMetaData:
    """A DataSetMetaDataType."""
    namespaces = decode_strings(cursor)
    most = cursor.elements + MOST_DESCRIBED

    def count(cursor: Cursor, smallest: int) -> int:
        return _count(cursor, smallest, most)

    structures = tuple([decode_structure(cursor, count) for _ in range(count(cursor, SMALLEST_DESCRIPTION))])
    enumerations = tuple([decode_enumeration(cursor, count) for _ in range(count(cursor, SMALLEST_DESCRIPTION))])
    simple_types = tuple([decode_simple_type(cursor) for _ in range(count(cursor, SMALLEST_DESCRIPTION))])
    name = decode_string(cursor) or ""
    description = decode_localized_text(cursor)
    fields = tuple([_decode_field(cursor, most) for _ in range(_count(cursor, SMALLEST_FIELD, most))])
    class_id = decode_guid(cursor)
    version = ConfigurationVersion(cursor.uint32(), cursor.uint32())
    return DataSetMetaData(
        name, fields, version, description, class_id, namespaces, structures, enumerations, simple_types
    )


def _count(cursor: Cursor, smallest: int, most: int) -> int:
    """How many parts follow; raises RemoteWireError where the message has more than `most` by then."""
    before = cursor.elements
    count = cursor.length(smallest) or 0
    cursor.elements = before + count  # whether or not the cursor has counted them
    if cursor.elements > most:
        raise RemoteWireError(Cause.TOO_MANY, f"metadata of more than {MOST_DESCRIBED} parts", cursor.position - 4)
    return count


def _decode_field(cursor: Cursor, most: int) -> FieldMetaData:
    name = decode_string(cursor) or ""
    description = decode_localized_text(cursor)
    field_flags, builtin_type = cursor.unpack(_FLAGS_AND_TYPE)
    data_type = decode_node_id(cursor)
    return FieldMetaData(
        name,
        builtin_type,
        description,
        field_flags,
        None if data_type == NodeId(0, builtin_type) else data_type,
        value_rank=cursor.int32(),
        array_dimensions=decode_uint32s(cursor),
        max_string_length=cursor.uint32(),
        data_set_field_id=decode_guid(cursor),
        properties=tuple([_decode_property(cursor) for _ in range(_count(cursor, SMALLEST_PROPERTY, most))]),
    )


def _decode_property(cursor: Cursor) -> tuple[QualifiedName, int, Any]:
    key = decode_qualified_name(cursor)
    variant = decode_variant(cursor)
    return key, variant.type, variant.value


def encode_metadata(out: bytearray, metadata: DataSetMetaData) -> None:
    """Append a DataSetMetaDataType."""
    encode_strings(out, metadata.namespaces)
    encode_length(out, len(metadata.structures))
    for structure in metadata.structures:
        encode_structure(out, structure)
    encode_length(out, len(metadata.enumerations))
    for enumeration in metadata.enumerations:
        encode_enumeration(out, enumeration)
    encode_length(out, len(metadata.simple_types))
    for simple_type in metadata.simple_types:
        encode_simple_type(out, simple_type)
    encode_string(out, metadata.name)
    encode_localized_text(out, metadata.description)
    encode_length(out, len(metadata.fields))
    for field in metadata.fields:
        _encode_field(out, field)
    encode_guid(out, metadata.data_set_class_id)
    encode_number(out, BuiltinType.UINT32, metadata.configuration_version.major)
    encode_number(out, BuiltinType.UINT32, metadata.configuration_version.minor)


def _encode_field(out: bytearray, field: FieldMetaData) -> None:
    if not BuiltinType.BOOLEAN <= field.builtin_type <= BuiltinType.DIAGNOSTIC_INFO:
        raise LocalWireError(f"field {field.name!r}: {field.builtin_type} is no built-in type")
    encode_string(out, field.name)
    encode_localized_text(out, field.description)
    encode_number(out, BuiltinType.UINT16, field.field_flags)
    encode_number(out, BuiltinType.BYTE, field.builtin_type)
    encode_node_id(out, NodeId(0, field.builtin_type) if field.data_type is None else field.data_type)
    encode_number(out, BuiltinType.INT32, field.value_rank)
    encode_uint32s(out, field.array_dimensions)
    encode_number(out, BuiltinType.UINT32, field.max_string_length)
    encode_guid(out, field.data_set_field_id)
    encode_length(out, len(field.properties))
    for key, code, value in field.properties:
        encode_qualified_name(out, key)
        encode_typed(out, code, value)
