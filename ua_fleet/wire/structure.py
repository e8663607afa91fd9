"""Structures as bytes, from tables of their fields, in both directions (OPC 10000-6 5.2.6, 5.2.5).

A `Shape` decodes and encodes one kind of value. A structure's shape is made of its fields' shapes in their order, which
is the order of the fields of the NamedTuple that it becomes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType, ExtensionObject, NodeId
from ua_fleet.wire.builtin import (
    FIXED,
    Decoder,
    Encoder,
    decode_byte_string,
    decode_extension_object,
    decode_guid,
    decode_localized_text,
    decode_node_id,
    decode_qualified_name,
    decode_string,
    encode_byte_string,
    encode_extension_object,
    encode_guid,
    encode_length,
    encode_localized_text,
    encode_node_id,
    encode_number,
    encode_qualified_name,
    encode_string,
)
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.variant import decode_variant, encode_variant

__all__ = [
    "BOOLEAN",
    "BYTE",
    "BYTE_STRING",
    "DOUBLE",
    "ENUMERATION",
    "GUID",
    "LOCALIZED_TEXT",
    "NODE_ID",
    "QUALIFIED_NAME",
    "STATUS_CODE",
    "STRING",
    "TEXT",
    "TIME",
    "UINT16",
    "UINT32",
    "VARIANT",
    "Elements",
    "Record",
    "Shape",
    "StructureChoice",
    "array",
    "array_decoder",
    "extension",
    "structure",
]

NULL_NODE_ID: Final = NodeId(0, 0)


class Shape(NamedTuple):
    """How values of one type are decoded and encoded."""

    smallest: int
    """Bytes that a value takes at least."""
    decode: Decoder
    encode: Encoder
    form: BuiltinType | Record | Elements | StructureChoice | None = None
    """What it is made of, for `annotate`; None where its decoder alone knows."""


class Record(NamedTuple):
    """The fields of a structure in their order."""

    names: tuple[str, ...]
    fields: tuple[Shape, ...]


class Elements(NamedTuple):
    """An array of something."""

    of: Shape


class StructureChoice(NamedTuple):
    """An ExtensionObject, with the structures that are known, by the number of their encoding."""

    known: Mapping[int, tuple[type, Shape]]


def _number(kind: BuiltinType) -> Shape:
    layout = FIXED[kind]

    def decode(cursor: Cursor) -> Any:
        return cursor.unpack(layout)[0]

    def encode(out: bytearray, value: Any) -> None:
        encode_number(out, kind, value)

    return Shape(layout.size, decode, encode, kind)


def _decode_text(cursor: Cursor) -> str:
    return decode_string(cursor) or ""


BOOLEAN: Final = _number(BuiltinType.BOOLEAN)
BYTE: Final = _number(BuiltinType.BYTE)
UINT16: Final = _number(BuiltinType.UINT16)
UINT32: Final = _number(BuiltinType.UINT32)
ENUMERATION: Final = _number(BuiltinType.INT32)
DOUBLE: Final = _number(BuiltinType.DOUBLE)
TIME: Final = _number(BuiltinType.DATETIME)
STATUS_CODE: Final = _number(BuiltinType.STATUS_CODE)
STRING: Final = Shape(4, decode_string, encode_string, BuiltinType.STRING)
TEXT: Final = Shape(4, _decode_text, encode_string, BuiltinType.STRING)
"""A String of which null and empty are the same."""
BYTE_STRING: Final = Shape(4, decode_byte_string, encode_byte_string, BuiltinType.BYTE_STRING)
GUID: Final = Shape(16, decode_guid, encode_guid, BuiltinType.GUID)
NODE_ID: Final = Shape(2, decode_node_id, encode_node_id, BuiltinType.NODE_ID)
QUALIFIED_NAME: Final = Shape(6, decode_qualified_name, encode_qualified_name, BuiltinType.QUALIFIED_NAME)
LOCALIZED_TEXT: Final = Shape(1, decode_localized_text, encode_localized_text, BuiltinType.LOCALIZED_TEXT)
VARIANT: Final = Shape(1, decode_variant, encode_variant, BuiltinType.VARIANT)


def structure(make: Callable[..., Any], *fields: Shape) -> Shape:
    """The shape of a structure that becomes a NamedTuple, which `make` makes of its fields."""

    def decode(cursor: Cursor) -> Any:
        return make(*[field.decode(cursor) for field in fields])

    def encode(out: bytearray, value: Any) -> None:
        if type(value) is not make:
            raise LocalWireError(f"{value!r:.80} is no {getattr(make, '__name__', make)}")
        for field, part in zip(fields, value, strict=True):
            field.encode(out, part)

    names: tuple[str, ...] = getattr(make, "_fields", ())
    return Shape(sum(field.smallest for field in fields), decode, encode, Record(names, fields))


def array_decoder(smallest: int, decode: Decoder) -> Decoder:
    """Decodes an array, which becomes a tuple, of elements that take `smallest` bytes at least; a null one is empty."""

    def decode_array(cursor: Cursor) -> Any:
        return tuple([decode(cursor) for _ in range(cursor.length(smallest) or 0)])

    return decode_array


def array(element: Shape) -> Shape:
    """The shape of an array, which becomes a tuple; a null array is empty."""

    def encode(out: bytearray, value: Any) -> None:
        encode_length(out, len(value))
        for part in value:
            element.encode(out, part)

    return Shape(4, array_decoder(element.smallest, element.decode), encode, Elements(element))


def extension(known: Mapping[int, tuple[type, Shape]] | None = None) -> Shape:
    """The shape of a structure of which subtypes are allowed: an ExtensionObject.

    Args:
        known: by the number of their binary encoding's NodeId in namespace 0, the structures that are decoded. Others
            stay ExtensionObjects; None stands for null.
    """
    shapes = known or {}
    numbers = {kind: number for number, (kind, _) in shapes.items()}

    def decode(cursor: Cursor) -> Any:
        value = decode_extension_object(cursor)
        namespace, number = value.type_id
        if value.body is None:
            return None if value.type_id == NULL_NODE_ID else value
        entry = shapes.get(number) if namespace == 0 and isinstance(number, int) else None
        if entry is None or not isinstance(value.body, bytes):
            return value
        whole, cursor.end = cursor.end, cursor.position
        cursor.position -= len(value.body)  # read once more, as what it is; where that fails, the message is dropped
        decoded = entry[1].decode(cursor)
        if cursor.remaining:
            detail = f"{cursor.remaining} bytes behind the structure i={number!r}"
            raise RemoteWireError(Cause.TRAILING_BYTES, detail, cursor.position)
        cursor.end = whole
        return decoded

    def encode(out: bytearray, value: Any) -> None:
        number = numbers.get(value.__class__)
        if value is None:
            value = ExtensionObject(NULL_NODE_ID, None)
        elif number is not None:
            body = bytearray()
            shapes[number][1].encode(body, value)
            value = ExtensionObject(NodeId(0, number), bytes(body))
        encode_extension_object(out, value)

    return Shape(3, decode, encode, StructureChoice(shapes))
