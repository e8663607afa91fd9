"""Built-in types as bytes, in both directions, as far as they do not nest (OPC 10000-6 5.2.2).

`variant.py` has those that contain other values, and the two tables over all of them.
"""

from __future__ import annotations

import struct
import uuid
from collections.abc import Callable
from struct import Struct
from typing import Any, Final

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import (
    BuiltinType,
    ExpandedNodeId,
    ExtensionObject,
    LocalizedText,
    NodeId,
    QualifiedName,
)
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.packed import is_packed

__all__ = [
    "FIXED",
    "MISFITS",
    "Decoder",
    "Encoder",
    "decode_byte_string",
    "decode_guid",
    "decode_localized_text",
    "decode_node_id",
    "decode_qualified_name",
    "decode_string",
    "decode_strings",
    "decode_uint16s",
    "decode_uint32s",
    "encode_byte_string",
    "encode_guid",
    "encode_localized_text",
    "encode_node_id",
    "encode_number",
    "encode_qualified_name",
    "encode_string",
    "encode_strings",
    "encode_uint16s",
    "encode_uint32s",
]

Decoder = Callable[[Cursor], Any]
Encoder = Callable[[bytearray, Any], None]

FIXED: Final[dict[int, Struct]] = {
    BuiltinType.BOOLEAN: Struct("<?"),
    BuiltinType.SBYTE: Struct("<b"),
    BuiltinType.BYTE: Struct("<B"),
    BuiltinType.INT16: Struct("<h"),
    BuiltinType.UINT16: Struct("<H"),
    BuiltinType.INT32: Struct("<i"),
    BuiltinType.UINT32: Struct("<I"),
    BuiltinType.INT64: Struct("<q"),
    BuiltinType.UINT64: Struct("<Q"),
    BuiltinType.FLOAT: Struct("<f"),
    BuiltinType.DOUBLE: Struct("<d"),
    BuiltinType.DATETIME: Struct("<q"),
    BuiltinType.STATUS_CODE: Struct("<I"),
}
"""The types whose value is one number of fixed size."""

_NULL_LENGTH: Final = b"\xff\xff\xff\xff"
_LENGTH = Struct("<i")
_FOUR_BYTE_NODE_ID = Struct("<BH")
_NUMERIC_NODE_ID = Struct("<HI")

NAMESPACE_URI_FLAG: Final = 0x80
SERVER_INDEX_FLAG: Final = 0x40
"""Flags in the encoding byte of an ExpandedNodeId (OPC 10000-6 5.2.2.10)."""


MISFITS: Final = (TypeError, ValueError, AttributeError, OverflowError, struct.error)
"""What Python raises where a part of a message is of an altogether wrong type; encoders report it as LocalWireError."""


def encode_number(out: bytearray, kind: int, value: Any) -> None:
    """Append a number of one of the FIXED types."""
    if kind == BuiltinType.BOOLEAN and not isinstance(value, bool):
        raise LocalWireError(f"{value!r:.80} is no Boolean")
    try:
        out += FIXED[kind].pack(value)
    except (struct.error, OverflowError) as error:
        raise LocalWireError(f"{value!r:.80} does not fit into {BuiltinType(kind).name}: {error}") from None


def encode_length(out: bytearray, count: int) -> None:
    """Append the Int32 count of a string's bytes or an array's elements."""
    if count > 0x7FFF_FFFF:
        raise LocalWireError(f"{count} elements are more than an Int32 can count")
    out += _LENGTH.pack(count)


def decode_byte_string(cursor: Cursor) -> bytes | None:
    """A ByteString, or None for null (OPC 10000-6 5.2.2.7)."""
    size = cursor.length(1)
    return None if size is None else cursor.take(size)


def encode_byte_string(out: bytearray, value: Any) -> None:
    """Append a ByteString."""
    if value is None:
        out += _NULL_LENGTH
        return
    if not isinstance(value, bytes | bytearray) and not is_packed(value, "B"):
        raise LocalWireError(f"{value!r:.80} is no ByteString")
    encode_length(out, len(value))
    out += value


def decode_string(cursor: Cursor) -> str | None:
    """A String, or None for null (OPC 10000-6 5.2.2.4)."""
    size = cursor.length(1)
    if size is None:
        return None
    try:
        return str(cursor.take(size), "utf-8")
    except UnicodeDecodeError as error:
        raise RemoteWireError(Cause.INVALID_UTF8, error.reason, cursor.position - size) from None


def encode_string(out: bytearray, value: Any) -> None:
    """Append a String."""
    if value is None:
        out += _NULL_LENGTH
        return
    if not isinstance(value, str):
        raise LocalWireError(f"{value!r:.80} is no String")
    try:
        text = value.encode()
    except UnicodeEncodeError as error:
        raise LocalWireError(f"a String that UTF-8 cannot hold: {error.reason}") from None
    encode_length(out, len(text))
    out += text


def decode_guid(cursor: Cursor) -> uuid.UUID:
    """A Guid (OPC 10000-6 5.2.2.6): the first three groups are little endian."""
    return uuid.UUID(bytes_le=cursor.take(16))


def encode_guid(out: bytearray, value: Any) -> None:
    """Append a Guid."""
    if not isinstance(value, uuid.UUID):
        raise LocalWireError(f"{value!r:.80} is no Guid")
    out += value.bytes_le


def decode_node_id(cursor: Cursor) -> NodeId:
    """A NodeId (OPC 10000-6 5.2.2.9)."""
    return _decode_node_id(cursor, cursor.byte())


def _decode_node_id(cursor: Cursor, encoding: int) -> NodeId:
    if encoding == 0:
        return NodeId(0, cursor.byte())
    if encoding == 1:
        return NodeId(*cursor.unpack(_FOUR_BYTE_NODE_ID))
    if encoding == 2:
        return NodeId(*cursor.unpack(_NUMERIC_NODE_ID))
    if encoding == 3:
        return NodeId(cursor.uint16(), decode_string(cursor) or "")
    if encoding == 4:
        return NodeId(cursor.uint16(), decode_guid(cursor))
    if encoding == 5:
        return NodeId(cursor.uint16(), decode_byte_string(cursor) or b"")
    raise RemoteWireError(Cause.NODE_ID_ENCODING, f"encoding byte 0x{encoding:02x}", cursor.position - 1)


def encode_node_id(out: bytearray, value: Any) -> None:
    """Append a NodeId in its shortest form."""
    _encode_node_id(out, value, 0)


def _encode_node_id(out: bytearray, value: Any, flags: int) -> None:
    if not isinstance(value, NodeId):
        raise LocalWireError(f"{value!r:.80} is no NodeId")
    namespace, identifier = value
    if not 0 <= namespace <= 0xFFFF:
        raise LocalWireError(f"{value} has no legal namespace index")
    if isinstance(identifier, int):
        if not 0 <= identifier <= 0xFFFF_FFFF:
            raise LocalWireError(f"{value} has no legal identifier")
        if namespace == 0 and identifier <= 0xFF:
            out += bytes((flags, identifier))
        elif namespace <= 0xFF and identifier <= 0xFFFF:
            out.append(flags | 1)
            out += _FOUR_BYTE_NODE_ID.pack(namespace, identifier)
        else:
            out.append(flags | 2)
            out += _NUMERIC_NODE_ID.pack(namespace, identifier)
        return
    if isinstance(identifier, str):
        kind, encode = 3, encode_string
    elif isinstance(identifier, uuid.UUID):
        kind, encode = 4, encode_guid
    else:
        kind, encode = 5, encode_byte_string
    out.append(flags | kind)
    out += namespace.to_bytes(2, "little")
    encode(out, identifier)


def decode_expanded_node_id(cursor: Cursor) -> ExpandedNodeId:
    """An ExpandedNodeId (OPC 10000-6 5.2.2.10)."""
    encoding = cursor.byte()
    node_id = _decode_node_id(cursor, encoding & ~(NAMESPACE_URI_FLAG | SERVER_INDEX_FLAG))
    namespace_uri = decode_string(cursor) if encoding & NAMESPACE_URI_FLAG else None
    server_index = cursor.uint32() if encoding & SERVER_INDEX_FLAG else 0
    return ExpandedNodeId(node_id, namespace_uri, server_index)


def encode_expanded_node_id(out: bytearray, value: Any) -> None:
    """Append an ExpandedNodeId."""
    if not isinstance(value, ExpandedNodeId):
        raise LocalWireError(f"{value!r:.80} is no ExpandedNodeId")
    flags = NAMESPACE_URI_FLAG if value.namespace_uri is not None else 0
    flags |= SERVER_INDEX_FLAG if value.server_index else 0
    _encode_node_id(out, value.node_id, flags)
    if value.namespace_uri is not None:
        encode_string(out, value.namespace_uri)
    if value.server_index:
        encode_number(out, BuiltinType.UINT32, value.server_index)


def decode_qualified_name(cursor: Cursor) -> QualifiedName:
    """A QualifiedName (OPC 10000-6 5.2.2.13)."""
    return QualifiedName(cursor.uint16(), decode_string(cursor))


def encode_qualified_name(out: bytearray, value: Any) -> None:
    """Append a QualifiedName."""
    if not isinstance(value, QualifiedName):
        raise LocalWireError(f"{value!r:.80} is no QualifiedName")
    encode_number(out, BuiltinType.UINT16, value.namespace)
    encode_string(out, value.name)


def decode_localized_text(cursor: Cursor) -> LocalizedText:
    """A LocalizedText (OPC 10000-6 5.2.2.14)."""
    mask = cursor.byte()
    if mask & ~0x03:
        raise RemoteWireError(Cause.RESERVED_MASK_BITS, f"LocalizedText mask 0x{mask:02x}", cursor.position - 1)
    locale = decode_string(cursor) if mask & 0x01 else None
    text = decode_string(cursor) if mask & 0x02 else None
    return LocalizedText(text, locale)


def encode_localized_text(out: bytearray, value: Any) -> None:
    """Append a LocalizedText."""
    if not isinstance(value, LocalizedText):
        raise LocalWireError(f"{value!r:.80} is no LocalizedText")
    out.append((0x01 if value.locale is not None else 0) | (0x02 if value.text is not None else 0))
    if value.locale is not None:
        encode_string(out, value.locale)
    if value.text is not None:
        encode_string(out, value.text)


def decode_extension_object(cursor: Cursor) -> ExtensionObject:
    """An ExtensionObject; its body is not looked into (OPC 10000-6 5.2.2.15)."""
    type_id = decode_node_id(cursor)
    encoding = cursor.byte()
    if encoding == 0:
        return ExtensionObject(type_id, None)
    if encoding == 1:
        return ExtensionObject(type_id, decode_byte_string(cursor))
    if encoding == 2:
        return ExtensionObject(type_id, decode_string(cursor))
    raise RemoteWireError(Cause.EXTENSION_OBJECT_ENCODING, f"encoding byte 0x{encoding:02x}", cursor.position - 1)


def encode_extension_object(out: bytearray, value: Any) -> None:
    """Append an ExtensionObject."""
    if not isinstance(value, ExtensionObject):
        raise LocalWireError(f"{value!r:.80} is no ExtensionObject")
    if isinstance(value.body, bytes) and value.body.__class__ is not bytes:  # text of JSON, and no Binary body
        raise LocalWireError(f"a structure of type {value.type_id} that no description tells how to write")
    encode_node_id(out, value.type_id)
    if value.body is None:
        out.append(0)
    elif isinstance(value.body, str):
        out.append(2)
        encode_string(out, value.body)
    else:
        out.append(1)
        encode_byte_string(out, value.body)


def decode_uint16s(cursor: Cursor) -> tuple[int, ...]:
    """An array of UInt16; a null array is empty."""
    count = cursor.length(2) or 0
    return tuple(cursor.unpack(Struct(f"<{count}H"))) if count else ()


def encode_uint16s(out: bytearray, values: tuple[int, ...]) -> None:
    """Append an array of UInt16."""
    encode_length(out, len(values))
    for value in values:
        encode_number(out, BuiltinType.UINT16, value)


def decode_uint32s(cursor: Cursor) -> tuple[int, ...]:
    """An array of UInt32; a null array is empty."""
    count = cursor.length(4) or 0
    return tuple(cursor.unpack(Struct(f"<{count}I"))) if count else ()


def encode_uint32s(out: bytearray, values: tuple[int, ...]) -> None:
    """Append an array of UInt32."""
    encode_length(out, len(values))
    for value in values:
        encode_number(out, BuiltinType.UINT32, value)


def decode_strings(cursor: Cursor) -> tuple[str, ...]:
    """An array of String; a null array is empty, as is a null String."""
    count = cursor.length(4) or 0
    return tuple([decode_string(cursor) or "" for _ in range(count)])


def encode_strings(out: bytearray, values: tuple[str, ...]) -> None:
    """Append an array of String."""
    encode_length(out, len(values))
    for value in values:
        encode_string(out, value)
