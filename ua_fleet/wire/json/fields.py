"""The fields of DataSets as JSON, by their metadata (OPC 10000-14 7.2.5.4, tables 112, 186 and 187).

    Verbose   a field of a concrete DataType is the bare value, as a member of a structure is; one of an abstract type
              or rank is a Variant with its `UaType`; with status or times it is a DataValue around that
    RawData   the same without `UaType` and `UaTypeId`
    Compact   each field is a Variant or a DataValue with its `UaType`

All of them are read, whichever a message has, and so are the forms of older editions (OPC 10000-6 annex H).
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any, Final, NamedTuple, cast

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, DataValue, ExtensionObject, Matrix, NodeId, Variant
from ua_fleet.wire.descriptions import StructureDescription
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.data_types import DataTypes
from ua_fleet.wire.json.node_ids import NULL_NODE_ID, encode_node_id
from ua_fleet.wire.json.parsing import Reading, dump, shown
from ua_fleet.wire.json.scalars import RANGES, decode_status, encode_status
from ua_fleet.wire.json.structures import (
    JsonBody,
    decode_enumeration,
    decode_extension_object,
    decode_structure,
    encode_enumeration,
    encode_structure,
)
from ua_fleet.wire.json.variants import (
    DATA_VALUE_MEMBERS,
    NEVER_NULL,
    VARIANT_MEMBERS,
    Writing,
    decode_data_value,
    decode_element,
    decode_shape,
    decode_variant,
    dimensions_of,
    encode_element,
    encode_value,
    encode_variant,
    read_sides,
    write_sides,
)
from ua_fleet.wire.messages import DataSetMetaData, FieldMetaData

__all__ = ["Field", "FieldValue", "Form", "decode_field", "encode_data_value_field", "encode_field", "planned_fields"]


class Form(Enum):
    """How the fields of a DataSetMessage are written."""

    COMPACT = "compact"
    VERBOSE = "verbose"
    RAW_DATA = "raw_data"


class FieldValue(NamedTuple):
    """A field as it was read: its value, and the DataValue around it where there was one."""

    type: int
    value: Any
    data_value: DataValue | None = None


NO_VALUE: Final = FieldValue(0, None)

_STATUS: Final = BuiltinType.STATUS_CODE
_EMPTY_OBJECTS: Final = (
    _STATUS,
    BuiltinType.LOCALIZED_TEXT,
    BuiltinType.EXTENSION_OBJECT,
    BuiltinType.DIAGNOSTIC_INFO,
)
"""Types of which `{}` is a value."""
_STATUS_MEMBERS: Final = frozenset({"Code", "Symbol"})
_OLD_VARIANT_MEMBERS: Final = frozenset({"Type", "Body", "Dimensions"})
_STRUCTURE_MEMBERS: Final = frozenset({"EncodingMask", "SwitchField", "UaTypeId"})


class Field(NamedTuple):
    """What the decoding and encoding of one field needs."""

    name: str
    kind: int
    code: int
    """The type code of its values; where `is_abstract`, of most of them."""
    is_abstract: bool
    """A DataType or a ValueRank that leaves the type of a value open."""
    data_type: NodeId
    structure: StructureDescription | None
    members: frozenset[str]
    """What the object of its structure may have."""
    names: dict[int, str] | None
    """Of an enumeration."""


def planned_fields(metadata: DataSetMetaData, types: DataTypes) -> tuple[Field, ...]:
    """The fields of a metadata; raises RemoteWireError where it contradicts itself."""
    if len({field.name for field in metadata.fields}) != len(metadata.fields):
        raise RemoteWireError(JsonCause.METADATA, "two fields of one name")
    # Made once for each structure: many fields may be of one that has many members.
    members = {
        structure.data_type: _STRUCTURE_MEMBERS | {member.name for member in structure.fields}
        for field in metadata.fields
        if (structure := types.structure(_data_type(field))) is not None
    }
    return tuple([_planned(field, types, members) for field in metadata.fields])


def _data_type(field: FieldMetaData) -> NodeId:
    return NodeId(0, field.builtin_type) if field.data_type is None else field.data_type


def _planned(field: FieldMetaData, types: DataTypes, members: Mapping[NodeId, frozenset[str]]) -> Field:
    kind, rank = field.builtin_type, field.value_rank
    if not BuiltinType.BOOLEAN <= kind <= BuiltinType.DIAGNOSTIC_INFO:
        raise RemoteWireError(JsonCause.METADATA, f"field {shown(field.name)} has the built-in type {kind}")
    data_type = _data_type(field)
    resolved = types.resolve(data_type)
    structure = None if resolved is None or kind != BuiltinType.EXTENSION_OBJECT else resolved.structure
    return Field(
        field.name,
        kind,
        kind | (ARRAY if rank > 0 else 0) | (DIMENSIONS if rank > 1 else 0),
        kind == BuiltinType.VARIANT or rank in (0, -2),
        data_type,
        structure,
        frozenset() if structure is None else members[structure.data_type],
        None if resolved is None or kind != BuiltinType.INT32 else resolved.names,
    )


# --- reading


def decode_field(reading: Reading, field: Field, item: Any) -> FieldValue:
    """A field in any form."""
    if item is None:
        return FieldValue(*_decode_null(reading, field))
    if item.__class__ is dict:
        return _decode_object(reading, field, item)
    return FieldValue(*_decode_bare(reading, field, item))


def _decode_null(reading: Reading, field: Field) -> tuple[int, Any]:
    """What null stands for: the null of a type that has one, otherwise that there is no value."""
    if field.is_abstract or (field.kind in (*NEVER_NULL, BuiltinType.DIAGNOSTIC_INFO) and not field.code & ARRAY):
        return 0, None
    return field.code, None if field.code & ARRAY else decode_element(reading, field.kind, None)


def _decode_object(reading: Reading, field: Field, item: dict[str, Any]) -> FieldValue:
    members = item.keys()
    if field.kind == BuiltinType.DATA_VALUE and not field.is_abstract and item.get("UaType") != field.kind:
        return FieldValue(BuiltinType.DATA_VALUE.value, decode_data_value(reading, item))
    if "UaType" in item:
        variant = decode_variant(reading, item)
        return _with_sides(reading, item, variant, VARIANT_MEMBERS)
    if field.structure is not None and members <= field.members:
        return FieldValue(*_decode_bare(reading, field, item))
    if "Type" in item and members <= _OLD_VARIANT_MEMBERS:
        return FieldValue(*decode_variant(reading, item))
    if not members:
        return _decode_empty(reading, field, item)
    if members <= DATA_VALUE_MEMBERS:
        return _decode_data_value(reading, field, item)
    if members <= _STATUS_MEMBERS and field.kind != _STATUS:
        return FieldValue(_STATUS.value, decode_status(reading, item))  # a Bad field, with its status for its value
    return FieldValue(*_decode_bare(reading, field, item))


def _with_sides(reading: Reading, item: dict[str, Any], variant: Variant, bare: frozenset[str]) -> FieldValue:
    if item.keys() <= bare:
        return FieldValue(variant.type, variant.value)
    data_value = read_sides(reading, item, variant if variant.type else None)
    return FieldValue(variant.type, variant.value, data_value)


def _decode_empty(reading: Reading, field: Field, item: dict[str, Any]) -> FieldValue:
    """`{}`: Good, a null text or structure, otherwise a DataValue without all of its parts."""
    if field.kind in _EMPTY_OBJECTS and not field.is_abstract:
        return FieldValue(*_decode_bare(reading, field, item))
    return FieldValue(0, None, DataValue(None))


def _decode_data_value(reading: Reading, field: Field, item: dict[str, Any]) -> FieldValue:
    inner = item.get("Value")
    if inner is None:
        variant = Variant(*_decode_null(reading, field)) if "Value" in item else Variant(0, None)
    elif inner.__class__ is dict and ("UaType" in inner or ("Type" in inner and "Body" in inner)):
        variant = decode_variant(reading, inner)
    elif _is_status(field, inner):  # as RawData writes a Bad field of an abstract type
        variant = Variant(_STATUS.value, decode_status(reading, inner))
    else:
        variant = Variant(*_decode_bare(reading, field, inner, dimensions_of(reading, item)))
    # RawData writes a Variant of an abstract field without its type: then there is no DataValue around it.
    bare = VARIANT_MEMBERS if field.is_abstract else frozenset[str]()
    return _with_sides(reading, item, variant, bare)


def _is_status(field: Field, item: Any) -> bool:
    """Whether an object is a StatusCode in place of a field's value."""
    is_other = field.kind != _STATUS and field.structure is None
    return is_other and item.__class__ is dict and bool(item) and item.keys() <= _STATUS_MEMBERS


def _decode_bare(reading: Reading, field: Field, item: Any, dimensions: Any = None) -> tuple[int, Any]:
    """The value of a field without anything around it."""
    bits, shaped = decode_shape(reading, item, dimensions)
    if not bits:
        return _decode_element(reading, field, shaped)
    elements = shaped if bits == ARRAY else shaped.values
    if field.kind == BuiltinType.VARIANT:
        kind, values = _infer_elements(reading, elements)
    else:
        kind, values = field.kind, tuple([_decode_element(reading, field, element)[1] for element in elements])
    return kind | bits, values if bits == ARRAY else Matrix(values, shaped.dimensions)


def _decode_element(reading: Reading, field: Field, item: Any) -> tuple[int, Any]:
    kind = field.kind
    if kind == BuiltinType.EXTENSION_OBJECT:
        return kind, _decode_structure(reading, field, item)
    if kind == BuiltinType.VARIANT:
        return _infer(reading, item)
    if field.names is not None:
        return kind, decode_enumeration(reading, item)
    return kind, decode_element(reading, kind, item)


def _decode_structure(reading: Reading, field: Field, item: Any) -> ExtensionObject:
    if item is None or (item.__class__ is dict and ("UaTypeId" in item or ("TypeId" in item and "Body" in item))):
        return decode_extension_object(reading, item)
    if item == {} and field.structure is None:
        return ExtensionObject(NULL_NODE_ID, None)
    return decode_structure(reading, field.data_type, item)


def _infer(reading: Reading, item: Any) -> tuple[int, Any]:
    """Type and value of what has no type: RawData of an abstract DataType, or NonReversibleEncoding."""
    if item is None:
        return 0, None
    if item.__class__ is dict and ("UaType" in item or ("Type" in item and "Body" in item)):
        return decode_variant(reading, item)
    reading.note(Leniency.TYPE_INFERRED)
    if item.__class__ is bool:
        return BuiltinType.BOOLEAN.value, item
    if item.__class__ is int:
        is_signed = item <= RANGES[BuiltinType.INT64][1]
        return (BuiltinType.INT64 if is_signed else BuiltinType.UINT64).value, item
    if item.__class__ is float:
        return BuiltinType.DOUBLE.value, item
    if item.__class__ is str:
        return BuiltinType.STRING.value, item
    if item.__class__ is dict:
        return BuiltinType.EXTENSION_OBJECT.value, ExtensionObject(NULL_NODE_ID, JsonBody(dump(item)))
    raise RemoteWireError(JsonCause.VALUE_TYPE, f"{shown(item)} is no value")


def _infer_elements(reading: Reading, elements: Any) -> tuple[int, tuple[Any, ...]]:
    items = [_infer(reading, element) for element in elements]
    kinds = {kind for kind, _ in items}
    if kinds == {BuiltinType.INT64, BuiltinType.DOUBLE}:
        return BuiltinType.DOUBLE.value, tuple([float(value) for _, value in items])
    if len(kinds) == 1 and 0 not in kinds and not next(iter(kinds)) & ARRAY:
        return kinds.pop(), tuple([value for _, value in items])
    return BuiltinType.VARIANT.value, tuple([Variant(*item) for item in items])


# --- writing


def encode_field(writing: Writing, field: Field, code: int, value: Any) -> Any:
    """What JSON holds of a field without status and times."""
    if not code:
        return None
    if not writing.verbose or field.is_abstract:
        return encode_variant(writing, Variant(code, value))
    if code != field.code:
        if code == _STATUS:  # a Bad field has its status for its value (OPC 10000-14 table 35)
            status = encode_status(writing.namespaces, writing.verbose, value)
            return status if writing.raw else {"UaType": code, "Value": status}
        return encode_variant(writing._replace(raw=False), Variant(code, value))
    held, dimensions = _encode_bare(writing, field, code, value)
    return held if dimensions is None else {"Array": held, "Dimensions": dimensions}


def _encode_bare(writing: Writing, field: Field, code: int, value: Any) -> tuple[Any, list[int] | None]:
    if field.kind != BuiltinType.EXTENSION_OBJECT and field.names is None:
        return encode_value(writing, code, value)
    if not code & ARRAY:
        return _encode_element(writing, field, value), None
    if value is None:
        return None, None
    elements = value.values if isinstance(value, Matrix) else value
    if not isinstance(elements, tuple | list):
        raise LocalWireError(f"{value!r:.80} is no array")
    held = [_encode_element(writing, field, element) for element in cast("tuple[Any, ...]", elements)]
    return held, list(value.dimensions) if isinstance(value, Matrix) else None


def _encode_element(writing: Writing, field: Field, value: Any) -> Any:
    if field.names is not None:
        return encode_enumeration(writing, field.names, value)
    if isinstance(value, ExtensionObject):
        described = encode_structure(writing, value)
        if described is not None:
            type_id, members = described
            if type_id == field.data_type or writing.raw:
                return members
            return {"UaTypeId": encode_node_id(writing.namespaces, type_id), **members}
    return encode_element(writing, field.kind, value)


def encode_data_value_field(writing: Writing, field: Field, value: DataValue) -> dict[str, Any]:
    """What JSON holds of a field with its status and times."""
    out: dict[str, Any] = {}
    code, inner = (0, None) if value.variant is None else value.variant
    if code:
        if writing.verbose and not field.is_abstract and code == field.code:
            out["Value"], dimensions = _encode_bare(writing, field, code, inner)
            if dimensions is not None:
                out["Dimensions"] = dimensions
        else:
            untyped = writing.raw and field.is_abstract
            out.update(encode_variant(writing._replace(raw=untyped), Variant(code, inner)) or {})
    write_sides(writing, value, out)
    return out
