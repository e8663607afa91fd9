"""Structures and unions: JSON beside the bytes that they have in UADP, by the description of their DataType.

A structure is an ExtensionObject with its Default Binary body whatever encoding it came in, so it goes from JSON to
UADP and back (OPC 10000-6 5.4.2.16, 5.4.6 to 5.4.8 beside 5.2.6 to 5.2.8). One without a description stays what it came
as: bytes are `UaBody` in JSON, and JSON is a `JsonBody`.
"""

from __future__ import annotations

import re
from typing import Any, Final, cast

import orjson

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType, DiagnosticInfo, ExtensionObject, Matrix, NodeId
from ua_fleet.wire.builtin import decode_uint32s, encode_length, encode_number, encode_uint32s
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.descriptions import StructureDescription, StructureField, StructureType
from ua_fleet.wire.json import variants
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.data_types import DataTypes, Resolved
from ua_fleet.wire.json.node_ids import NULL_NODE_ID, decode_node_id, encode_node_id
from ua_fleet.wire.json.parsing import Reading, dump, shown
from ua_fleet.wire.json.scalars import DEFAULTS, decode_byte_string, decode_integer, decode_string
from ua_fleet.wire.json.scalars import SCALAR_ENCODERS as _SCALARS
from ua_fleet.wire.variant import DECODERS, ENCODERS, NESTED_ENCODERS, SMALLEST

__all__ = [
    "JsonBody",
    "decode_enumeration",
    "decode_extension_object",
    "decode_structure",
    "encode_enumeration",
    "encode_extension_object",
    "encode_structure",
]

MOST_LEVELS: Final = 16
"""Structures in each other that we follow."""

_NUMBER: Final = re.compile(r"-?\d{1,10}", re.ASCII)
_BINARY: Final = 1
_XML: Final = 2
_UNIONS: Final = (StructureType.UNION, StructureType.UNION_WITH_SUBTYPED_VALUES)
_SUBTYPED: Final = (StructureType.WITH_SUBTYPED_VALUES, StructureType.UNION_WITH_SUBTYPED_VALUES)

_EXTENSION_OBJECT: Final = Resolved(BuiltinType.EXTENSION_OBJECT)
_VARIANT: Final = Resolved(BuiltinType.VARIANT)


class JsonBody(bytes):
    """The members of a structure as JSON text, which no description tells how to read."""


# --- ExtensionObject


def decode_extension_object(reading: Reading, value: Any) -> ExtensionObject:
    """An ExtensionObject that says its type, of the current or the older form; null has the null NodeId."""
    if value is None or value == {}:
        return ExtensionObject(NULL_NODE_ID, None)
    if value.__class__ is not dict:
        raise RemoteWireError(JsonCause.VALUE_TYPE, f"{shown(value)} is no structure")
    if "UaTypeId" in value:
        type_id = decode_node_id(reading, value["UaTypeId"])
        if "UaBody" in value:
            return _decode_opaque(reading, type_id, value.get("UaEncoding", _BINARY), value["UaBody"])
        return decode_structure(reading, type_id, {name: value[name] for name in value if name != "UaTypeId"})
    if "TypeId" in value:
        reading.note(Leniency.OLD_EXTENSION_OBJECT)
        type_id = decode_node_id(reading, value["TypeId"])
        encoding, body = value.get("Encoding") or 0, value.get("Body")
        if body is None:
            return ExtensionObject(type_id, None)
        return decode_structure(reading, type_id, body) if not encoding else _old_opaque(reading, type_id, value)
    raise RemoteWireError(JsonCause.STRUCTURE, f"a structure without its type: {shown(value)}")


def _old_opaque(reading: Reading, type_id: NodeId, value: dict[str, Any]) -> ExtensionObject:
    if value["Encoding"] == _XML:
        return ExtensionObject(type_id, decode_string(reading, value["Body"]))
    return _decode_opaque(reading, type_id, value["Encoding"], value["Body"])


def _decode_opaque(reading: Reading, type_id: NodeId, encoding: Any, body: Any) -> ExtensionObject:
    if encoding not in (_BINARY, _XML):
        raise RemoteWireError(JsonCause.STRUCTURE, f"encoding {shown(encoding)} of a structure")
    data = decode_byte_string(reading, body)
    if data is None:
        return ExtensionObject(type_id, None)
    if encoding == _BINARY:
        description = reading.types.structure(type_id)
        return ExtensionObject(type_id if description is None else _encoding_of(description), data)
    try:
        return ExtensionObject(type_id, data.decode())
    except UnicodeDecodeError:
        raise RemoteWireError(JsonCause.VALUE_TEXT, "an XML body that is no UTF-8") from None


def decode_structure(reading: Reading, type_id: NodeId, members: Any) -> ExtensionObject:
    """A structure of a DataType (or of its encoding) from its members."""
    description = reading.types.structure(type_id)
    if description is not None:
        body = bytearray()
        try:
            if _pack(reading, body, description, members, 0):
                return ExtensionObject(_encoding_of(description), bytes(body))
        except LocalWireError as error:  # a value that JSON can hold and UADP cannot
            raise RemoteWireError(JsonCause.STRUCTURE, str(error)[:200]) from None
    if members.__class__ is not dict:
        raise RemoteWireError(JsonCause.VALUE_TYPE, f"{shown(members)} is no structure")
    reading.note(Leniency.STRUCTURE_UNDESCRIBED)
    return ExtensionObject(type_id, JsonBody(orjson.dumps(members)))


def _encoding_of(description: StructureDescription) -> NodeId:
    encoding = description.default_encoding
    return description.data_type if encoding == NULL_NODE_ID else encoding


def encode_extension_object(writing: variants.Writing, value: Any) -> dict[str, Any] | None:
    """The object of an ExtensionObject with its type, None for null."""
    if not isinstance(value, ExtensionObject):
        raise LocalWireError(f"{value!r:.80} is no ExtensionObject")
    if value.type_id == NULL_NODE_ID and value.body is None:
        return {} if writing.verbose else None
    described = encode_structure(writing, value)
    if described is not None:
        type_id, members = described
        return members if writing.raw else {"UaTypeId": encode_node_id(writing.namespaces, type_id), **members}
    out: dict[str, Any] = {"UaTypeId": encode_node_id(writing.namespaces, value.type_id)}
    if isinstance(value.body, str):
        out["UaEncoding"] = _XML
        out["UaBody"] = _SCALARS[BuiltinType.BYTE_STRING]((), False, value.body.encode())
    elif value.body is not None:
        out["UaEncoding"] = _BINARY
        out["UaBody"] = _SCALARS[BuiltinType.BYTE_STRING]((), False, value.body)
    return out


def encode_structure(writing: variants.Writing, value: ExtensionObject) -> tuple[NodeId, dict[str, Any]] | None:
    """DataType and members of a structure; None for one that is not described, or not as it is described."""
    if isinstance(value.body, JsonBody):
        return value.type_id, orjson.loads(bytes(value.body))
    description = writing.types.structure(value.type_id)
    if description is None or value.body is None or isinstance(value.body, str):
        return None
    cursor = Cursor(bytes(value.body))
    try:
        members = _unpack(writing, cursor, description, 0)
    except RemoteWireError:
        return None
    return None if members is None or cursor.remaining else (description.data_type, members)


# --- what a member is made of


def _member(types: DataTypes, description: StructureDescription, field: StructureField) -> Resolved | None:
    resolved = types.resolve(field.data_type)
    if field.value_rank in (0, -2, -3):  # of no certain rank: a Variant (OPC 10000-6 5.1.7)
        return _VARIANT
    if resolved is not None and description.structure_type in _SUBTYPED and field.is_optional:
        return _EXTENSION_OBJECT if resolved.structure is not None else _VARIANT
    return resolved


def decode_enumeration(reading: Reading, value: Any) -> int:
    """An enumeration: a number (Compact), or its name and number (Verbose: `Red_1`)."""
    if value.__class__ is str:
        value = value[value.rfind("_") + 1 :]
        if _NUMBER.fullmatch(value):
            return decode_integer(reading, BuiltinType.INT32, int(value))
    return decode_integer(reading, BuiltinType.INT32, value)


def encode_enumeration(writing: variants.Writing, names: dict[int, str], value: Any) -> Any:
    """The number of an enumeration (Compact), or its name and number as text (Verbose)."""
    number = _SCALARS[BuiltinType.INT32]((), False, value)
    if not writing.verbose:
        return number
    name = names.get(number)
    return str(number) if name is None else f"{name}_{number}"


# --- JSON to bytes


def _pack(reading: Reading, out: bytearray, description: StructureDescription, value: Any, level: int) -> bool:
    """Append a structure; False where a member's DataType is not described."""
    reading.spend(1 + len(description.fields))
    if level > MOST_LEVELS:
        raise RemoteWireError(JsonCause.DEPTH, f"more than {MOST_LEVELS} structures in each other")
    if description.structure_type in _UNIONS:
        return _pack_union(reading, out, description, value, level)
    if value is None:
        value = {}
    if value.__class__ is not dict:
        raise RemoteWireError(JsonCause.VALUE_TYPE, f"{shown(value)} is no structure")
    fields = description.fields
    if description.structure_type == StructureType.WITH_OPTIONAL_FIELDS:
        optional = [field for field in fields if field.is_optional]
        mask = value.get("EncodingMask")
        if mask is None:  # VerboseEncoding: what is there is present
            mask = sum(1 << bit for bit, field in enumerate(optional) if field.name in value)
        mask = decode_integer(reading, BuiltinType.UINT32, mask)
        if mask >> len(optional):
            raise RemoteWireError(JsonCause.STRUCTURE, f"EncodingMask {mask} for {len(optional)} optional members")
        encode_number(out, BuiltinType.UINT32, mask)
        absent = {field.name for bit, field in enumerate(optional) if not mask >> bit & 1}
        fields = tuple([field for field in fields if field.name not in absent])
    return all(_pack_member(reading, out, description, field, value.get(field.name), level) for field in fields)


def _pack_union(reading: Reading, out: bytearray, description: StructureDescription, value: Any, level: int) -> bool:
    fields = description.fields
    if value is None or value == {}:
        encode_number(out, BuiltinType.UINT32, 0)
        return True
    if value.__class__ is not dict:
        return _pack_bare_union(reading, out, description, value, level)
    switch = value.get("SwitchField")
    if switch is None:  # VerboseEncoding: the one member says which it is
        present = [number for number, field in enumerate(fields, 1) if field.name in value]
        if len(present) != 1:
            raise RemoteWireError(JsonCause.STRUCTURE, f"{len(present)} members in a union")
        switch = present[0]
    switch = decode_integer(reading, BuiltinType.UINT32, switch)
    if switch > len(fields):
        raise RemoteWireError(JsonCause.STRUCTURE, f"SwitchField {switch} for {len(fields)} members")
    encode_number(out, BuiltinType.UINT32, switch)
    if not switch:
        return True
    field = fields[switch - 1]
    item = value.get(field.name)
    if item is None and "Value" in value:
        reading.note(Leniency.OLD_UNION)
        item = value["Value"]
    return _pack_member(reading, out, description, field, item, level)


def _pack_bare_union(
    reading: Reading, out: bytearray, description: StructureDescription, value: Any, level: int
) -> bool:
    """A union as its bare value (NonReversibleEncoding): that of the first member which it can be."""
    cost = 1 + len(dump(value)) // 32  # a long text or array is read once more for each member
    for switch, field in enumerate(description.fields, 1):
        reading.spend(cost)
        body = bytearray()
        try:
            if _pack_member(reading, body, description, field, value, level):
                reading.note(Leniency.OLD_UNION)
                encode_number(out, BuiltinType.UINT32, switch)
                out += body
                return True
        except RemoteWireError as error:
            if error.cause == JsonCause.ELEMENTS:  # the message has no more tries
                raise
    union = shown(description.name.name)
    raise RemoteWireError(JsonCause.STRUCTURE, f"{shown(value)} is no value of the union {union}")


def _pack_member(
    reading: Reading, out: bytearray, description: StructureDescription, field: StructureField, item: Any, level: int
) -> bool:
    resolved = _member(reading.types, description, field)
    if resolved is None:
        return False
    if field.value_rank < 1:
        return _pack_element(reading, out, resolved, item, level)
    if field.value_rank == 1:
        if item is None:
            encode_length(out, -1)
            return True
        if item.__class__ is not list:
            raise RemoteWireError(JsonCause.VALUE_TYPE, f"{shown(item)} is no array")
        encode_length(out, len(item))
        return all(_pack_element(reading, out, resolved, part, level) for part in cast("list[object]", item))
    return _pack_matrix(reading, out, resolved, item, level)


def _pack_matrix(reading: Reading, out: bytearray, resolved: Resolved, item: Any, level: int) -> bool:
    """An inline matrix: its dimensions, then its elements (OPC 10000-6 5.2.5, 5.4.5)."""
    if item is None:
        encode_length(out, -1)
        return True
    # The shape alone: its elements are looked at below.
    _, matrix = variants.decode_shape(reading, item)
    if not isinstance(matrix, Matrix):
        raise RemoteWireError(JsonCause.DIMENSIONS, f"{shown(item)} is no matrix")
    encode_uint32s(out, matrix.dimensions)
    return all(_pack_element(reading, out, resolved, part, level) for part in matrix.values)


def _pack_element(reading: Reading, out: bytearray, resolved: Resolved, item: Any, level: int) -> bool:
    kind, structure, names = resolved
    if structure is not None:
        return _pack(reading, out, structure, item, level + 1)
    if item is None:
        value = DEFAULTS.get(kind, DiagnosticInfo() if kind == BuiltinType.DIAGNOSTIC_INFO else None)
        if value is None and kind in (BuiltinType.EXTENSION_OBJECT, BuiltinType.VARIANT, BuiltinType.DATA_VALUE):
            value = variants.decode_element(reading, kind, None)
    elif names is not None:
        value = decode_enumeration(reading, item)
    else:
        value = variants.decode_element(reading, kind, item)
    nested = NESTED_ENCODERS.get(kind)
    if nested is not None:
        nested(out, value, 0)
    else:
        ENCODERS[kind](out, value)
    return True


# --- bytes to JSON


def _unpack(
    writing: variants.Writing, cursor: Cursor, description: StructureDescription, level: int
) -> dict[str, Any] | None:
    """The members of a structure; None where a member's DataType is not described."""
    if level > MOST_LEVELS:
        return None
    out: dict[str, Any] = {}
    fields = description.fields
    if description.structure_type in _UNIONS:
        switch = cursor.uint32()
        if switch > len(fields):
            return None
        if not switch:
            return out
        fields = fields[switch - 1 : switch]
        if not writing.verbose:
            out["SwitchField"] = switch
    elif description.structure_type == StructureType.WITH_OPTIONAL_FIELDS:
        mask = cursor.uint32()
        optional = [field.name for field in fields if field.is_optional]
        absent = {name for bit, name in enumerate(optional) if not mask >> bit & 1}
        fields = tuple([field for field in fields if field.name not in absent])
        if not writing.verbose:
            out["EncodingMask"] = mask
    for field in fields:
        resolved = _member(writing.types, description, field)
        if resolved is None:
            return None
        is_default, item = _unpack_member(writing, cursor, field, resolved, level)
        if writing.verbose or not is_default or description.structure_type in _UNIONS:
            out[field.name] = item
    return out


def _unreadable() -> RemoteWireError:
    return RemoteWireError(JsonCause.STRUCTURE, "a member that is not as it is described")


def _unpack_member(
    writing: variants.Writing, cursor: Cursor, field: StructureField, resolved: Resolved, level: int
) -> tuple[bool, Any]:
    """Whether a member has its default value, and what JSON holds of it."""
    if field.value_rank < 1:
        return _unpack_element(writing, cursor, resolved, level)
    if field.value_rank == 1:
        count = cursor.length(SMALLEST[resolved.kind] if resolved.structure is None else 1)
        if count is None:
            return True, None
        cursor.count_elements(count, 1)
        return False, [_unpack_element(writing, cursor, resolved, level)[1] for _ in range(count)]
    dimensions = decode_uint32s(cursor)
    total = 1 if dimensions else 0
    for dimension in dimensions:
        total *= dimension
        if total > cursor.remaining:
            raise _unreadable()
    if not dimensions:
        return True, None
    elements = [_unpack_element(writing, cursor, resolved, level)[1] for _ in range(total)]
    return False, {"Array": elements, "Dimensions": list(dimensions)}


def _unpack_element(writing: variants.Writing, cursor: Cursor, resolved: Resolved, level: int) -> tuple[bool, Any]:
    kind, structure, names = resolved
    if structure is not None:
        members = _unpack(writing, cursor, structure, level + 1)
        if members is None:
            raise _unreadable()
        return not members, members
    value = DECODERS[kind](cursor)
    if names is not None:
        return value == 0, encode_enumeration(writing, names, value)
    held = variants.encode_element(writing, kind, value)
    return held is None or (kind in DEFAULTS and value == DEFAULTS[kind]), held
