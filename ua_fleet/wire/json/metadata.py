"""DataSetMetaData as JSON objects (OPC 10000-14 6.2.3.2; its nested types OPC 10000-5 12.30 to 12.34)."""

from __future__ import annotations

import uuid
from typing import Any, Final

from ua_fleet.errors import RemoteWireError
from ua_fleet.values import BuiltinType, LocalizedText, NodeId, Variant
from ua_fleet.wire.descriptions import (
    EnumerationDescription,
    EnumerationField,
    SimpleTypeDescription,
    StructureDescription,
    StructureField,
)
from ua_fleet.wire.discovered import KeyValuePair
from ua_fleet.wire.json.causes import JsonCause
from ua_fleet.wire.json.node_ids import NULL_NODE_ID
from ua_fleet.wire.json.parsing import Reading, shown
from ua_fleet.wire.json.records import (
    BOOLEAN,
    BYTE,
    ENUMERATION,
    GUID,
    INT32,
    INT64,
    LOCALIZED_TEXT,
    NODE_ID,
    QUALIFIED_NAME,
    TEXT,
    UINT16,
    UINT32,
    VARIANT,
    Member,
    array,
    nested,
    record,
)
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, FieldMetaData
from ua_fleet.wire.metadata import MOST_DESCRIBED

__all__ = ["META_DATA", "PROPERTIES"]

PROPERTIES: Final = array(record(KeyValuePair, Key=QUALIFIED_NAME, Value=VARIANT))

VERSION: Final = record(ConfigurationVersion, MajorVersion=UINT32, MinorVersion=UINT32)


def _make_field(
    name: str,
    description: LocalizedText,
    flags: int,
    builtin_type: int,
    data_type: NodeId,
    value_rank: int,
    dimensions: tuple[int, ...],
    max_length: int,
    field_id: uuid.UUID,
    properties: tuple[KeyValuePair, ...],
) -> FieldMetaData:
    return FieldMetaData(
        name,
        builtin_type,
        description,
        flags,
        None if data_type in (NodeId(0, builtin_type), NULL_NODE_ID) else data_type,
        value_rank,
        dimensions,
        max_length,
        field_id,
        tuple([(pair.key, pair.value.type, pair.value.value) for pair in properties]),
    )


def _split_field(field: FieldMetaData) -> tuple[Any, ...]:
    return (
        field.name,
        field.description,
        field.field_flags,
        field.builtin_type,
        NodeId(0, field.builtin_type) if field.data_type is None else field.data_type,
        field.value_rank,
        field.array_dimensions,
        field.max_string_length,
        field.data_set_field_id,
        tuple([KeyValuePair(key, Variant(code, value)) for key, code, value in field.properties]),
    )


FIELD: Final = record(
    FieldMetaData,
    Name=TEXT,
    Description=LOCALIZED_TEXT,
    FieldFlags=UINT16,
    BuiltInType=BYTE,
    DataType=NODE_ID,
    ValueRank=INT32,
    ArrayDimensions=array(UINT32),
    MaxStringLength=UINT32,
    DataSetFieldId=GUID,
    Properties=PROPERTIES,
)._replace(make=_make_field, split=_split_field)


def _make_member(
    name: str, description: LocalizedText, data_type: NodeId, rank: int, dimensions: Any, length: int, is_optional: bool
) -> StructureField:
    return StructureField(name, data_type, rank, is_optional, description, dimensions, length)


def _split_member(field: StructureField) -> tuple[Any, ...]:
    return (
        field.name,
        field.description,
        field.data_type,
        field.value_rank,
        field.array_dimensions,
        field.max_string_length,
        field.is_optional,
    )


STRUCTURE_FIELD: Final = record(
    StructureField,
    Name=TEXT,
    Description=LOCALIZED_TEXT,
    DataType=NODE_ID,
    ValueRank=INT32,
    ArrayDimensions=array(UINT32),
    MaxStringLength=UINT32,
    IsOptional=BOOLEAN,
)._replace(make=_make_member, split=_split_member)


def _make_literal(value: int, display_name: Any, description: Any, name: str) -> EnumerationField:
    return EnumerationField(value, name, display_name, description)


def _split_literal(field: EnumerationField) -> tuple[Any, ...]:
    return field.value, field.display_name, field.description, field.name


ENUMERATION_FIELD: Final = record(
    EnumerationField, Value=INT64, DisplayName=LOCALIZED_TEXT, Description=LOCALIZED_TEXT, Name=TEXT
)._replace(make=_make_literal, split=_split_literal)


def _parts(*parts: Any) -> tuple[Any, ...]:
    return parts


# A StructureDescription holds its StructureDefinition as a structure of its own, and so does an EnumDescription.

STRUCTURE_DEFINITION: Final = record(
    tuple,
    DefaultEncodingId=NODE_ID,
    BaseDataType=NODE_ID,
    StructureType=ENUMERATION,
    Fields=array(STRUCTURE_FIELD),
)._replace(make=_parts)


def _make_structure(data_type: NodeId, name: Any, definition: tuple[Any, ...]) -> StructureDescription:
    encoding, base, kind, fields = definition
    return StructureDescription(data_type, name, fields, kind, encoding, base)


def _split_structure(value: StructureDescription) -> tuple[Any, ...]:
    definition = value.default_encoding, value.base_data_type, value.structure_type, value.fields
    return value.data_type, value.name, definition


STRUCTURE_DESCRIPTION: Final = record(
    StructureDescription, DataTypeId=NODE_ID, Name=QUALIFIED_NAME, StructureDefinition=nested(STRUCTURE_DEFINITION)
)._replace(make=_make_structure, split=_split_structure)

ENUMERATION_DEFINITION: Final = record(tuple, Fields=array(ENUMERATION_FIELD))._replace(make=_parts)


def _make_enumeration(
    data_type: NodeId, name: Any, definition: tuple[Any, ...], builtin_type: int
) -> EnumerationDescription:
    return EnumerationDescription(data_type, name, definition[0], builtin_type or BuiltinType.INT32)


def _split_enumeration(value: EnumerationDescription) -> tuple[Any, ...]:
    return value.data_type, value.name, (value.fields,), value.builtin_type


ENUMERATION_DESCRIPTION: Final = record(
    EnumerationDescription,
    DataTypeId=NODE_ID,
    Name=QUALIFIED_NAME,
    EnumDefinition=nested(ENUMERATION_DEFINITION),
    BuiltInType=BYTE,
)._replace(make=_make_enumeration, split=_split_enumeration)

SIMPLE_TYPE_DESCRIPTION: Final = record(
    SimpleTypeDescription, DataTypeId=NODE_ID, Name=QUALIFIED_NAME, BaseDataType=NODE_ID, BuiltInType=BYTE
)


def _make_metadata(
    namespaces: Any,
    structures: Any,
    enumerations: Any,
    simple_types: Any,
    name: str,
    description: Any,
    fields: Any,
    class_id: Any,
    version: Any,
) -> DataSetMetaData:
    return DataSetMetaData(
        name, fields, version, description, class_id, namespaces, structures, enumerations, simple_types
    )


def _split_metadata(value: DataSetMetaData) -> tuple[Any, ...]:
    return (
        value.namespaces,
        value.structures,
        value.enumerations,
        value.simple_types,
        value.name,
        value.description,
        value.fields,
        value.data_set_class_id,
        value.configuration_version,
    )


DATA_SET_META_DATA: Final = record(
    DataSetMetaData,
    Namespaces=array(TEXT),
    StructureDataTypes=array(STRUCTURE_DESCRIPTION),
    EnumDataTypes=array(ENUMERATION_DESCRIPTION),
    SimpleDataTypes=array(SIMPLE_TYPE_DESCRIPTION),
    Name=TEXT,
    Description=LOCALIZED_TEXT,
    Fields=array(FIELD),
    DataSetClassId=GUID,
    ConfigurationVersion=nested(VERSION),
)._replace(make=_make_metadata, split=_split_metadata)

MOST_NAMESPACES: Final = 256
"""Each NodeId and name of a metadata looks for its own among them."""

_LISTS: Final = ("StructureDataTypes", "EnumDataTypes", "SimpleDataTypes", "Fields")


def decode_metadata(reading: Reading, value: Any) -> DataSetMetaData:
    """A DataSetMetaDataType; the namespaces that it lists are those of its NodeIds and names."""
    if value.__class__ is not dict:
        raise RemoteWireError(JsonCause.SHAPE, f"metadata that is no object: {shown(value)}")
    parts = sum(len(value[name]) for name in _LISTS if value.get(name).__class__ is list)
    _check_parts(parts)
    namespaces = value.get("Namespaces")
    if namespaces.__class__ is list and len(namespaces) > MOST_NAMESPACES:
        raise RemoteWireError(JsonCause.ELEMENTS, f"metadata of more than {MOST_NAMESPACES} namespaces")
    outer = reading.namespaces
    reading.namespaces = array(TEXT).decode(reading, namespaces)
    try:
        metadata: DataSetMetaData = DATA_SET_META_DATA.decode(reading, value)
    finally:
        reading.namespaces = outer
    parts += sum([len(structure.fields) for structure in metadata.structures])
    parts += sum([len(enumeration.fields) for enumeration in metadata.enumerations])
    parts += sum([len(field.properties) for field in metadata.fields])
    _check_parts(parts)
    return metadata


def _check_parts(parts: int) -> None:
    if parts > MOST_DESCRIBED:
        raise RemoteWireError(JsonCause.ELEMENTS, f"metadata of more than {MOST_DESCRIBED} parts")


def encode_metadata(_namespaces: tuple[str, ...], metadata: DataSetMetaData) -> dict[str, Any]:
    """The object of a DataSetMetaDataType."""
    return DATA_SET_META_DATA.encode(metadata.namespaces, metadata)


META_DATA: Final = Member(decode_metadata, encode_metadata)
