"""Bytes of the built-in types (OPC 10000-6 5.2.2), the same as asyncua 2.1.0 makes.

What is rare goes to asyncua's own encoder; and so does what cannot be encoded, for the error that it has for that.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import struct
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, Final

from asyncua import ua
from asyncua.ua.ua_binary import Primitives, nodeid_to_binary, struct_to_binary, variant_to_binary

__all__ = [
    "NUMBERS",
    "encode_content",
    "encode_diagnostic_info",
    "encode_localized_text",
    "encode_node_id",
    "encode_qualified_name",
    "encode_string",
    "encode_time",
    "encode_variant",
]

NUMBERS: Final = {
    "SByte": "b",
    "Byte": "B",
    "Char": "B",
    "Boolean": "?",
    "Int16": "h",
    "UInt16": "H",
    "Int32": "i",
    "UInt32": "I",
    "Int64": "q",
    "UInt64": "Q",
    "Float": "f",
    "Double": "d",
}
"""What `struct` calls the numbers, little-endian."""

_NULL: Final = b"\xff\xff\xff\xff"
_LENGTH: Final = struct.Struct("<i")
_TIME: Final = struct.Struct("<q")
_INDEX: Final = struct.Struct("<h")
"""Signed, as asyncua has it."""
_TWO_BYTE: Final = ua.NodeIdType.TwoByte
_FOUR_BYTE: Final = ua.NodeIdType.FourByte
_NUMERIC: Final = ua.NodeIdType.Numeric
_STRING: Final = ua.NodeIdType.String
_OPAQUE: Final = ua.NodeIdType.ByteString
_GUID: Final = ua.NodeIdType.Guid
_GUID_HEAD: Final = struct.Struct("<BH")
_TWO: Final = struct.Struct("<BB")
_FOUR: Final = struct.Struct("<BBH")
_SEVEN: Final = struct.Struct("<BHI")
_NAMED: Final = struct.Struct("<BHi")
_FIRST_TIME: Final = datetime(1601, 1, 1, tzinfo=UTC)
_LAST_TIME: Final = datetime(9999, 12, 31, tzinfo=UTC)
"""Whole days up to it have no bounds to look at."""
_DAY_S: Final = 86_400
_TICKS: Final = 10_000_000
_ARRAY: Final = 0x80


def encode_string(text: str | bytes | None) -> bytes:
    """A String, or a ByteString."""
    if text is None:
        return _NULL
    data = text.encode("utf-8", "surrogateescape") if isinstance(text, str) else text
    return _LENGTH.pack(len(data)) + data


def encode_time(time: datetime) -> bytes:
    """A DateTime."""
    if time.tzinfo is UTC and _FIRST_TIME < time < _LAST_TIME:
        since = time - _FIRST_TIME
        return _TIME.pack((since.days * _DAY_S + since.seconds) * _TICKS + since.microseconds * 10)
    data: bytes = Primitives.DateTime.pack(time)
    return data


def encode_node_id(node_id: Any) -> bytes:
    """A NodeId or an ExpandedNodeId."""
    kind = node_id.NodeIdType
    if not isinstance(node_id, ua.ExpandedNodeId) or not (node_id.NamespaceUri or node_id.ServerIndex):
        if kind is _TWO_BYTE:
            return _TWO.pack(0, node_id.Identifier)
        if kind is _FOUR_BYTE:
            return _FOUR.pack(1, node_id.NamespaceIndex, node_id.Identifier)
        if kind is _STRING and isinstance(node_id.Identifier, str):
            data = node_id.Identifier.encode("utf-8", "surrogateescape")
            return _NAMED.pack(3, node_id.NamespaceIndex, len(data)) + data
        if kind is _NUMERIC:
            return _SEVEN.pack(2, node_id.NamespaceIndex, node_id.Identifier)
        if kind is _OPAQUE and isinstance(node_id.Identifier, bytes):
            return _NAMED.pack(5, node_id.NamespaceIndex, len(node_id.Identifier)) + node_id.Identifier
        if kind is _GUID:
            guid: Any = node_id.Identifier
            return _GUID_HEAD.pack(4, node_id.NamespaceIndex) + bytes(guid.bytes_le)
    return nodeid_to_binary(node_id)


def encode_qualified_name(name: Any) -> bytes:
    """A QualifiedName."""
    return _INDEX.pack(name.NamespaceIndex) + encode_string(name.Name)


def encode_localized_text(text: Any) -> bytes:
    """A LocalizedText."""
    if text.Locale is None:
        return b"\x00" if text.Text is None else b"\x02" + encode_string(text.Text)
    return (
        bytes((1 if text.Text is None else 3,))
        + encode_string(text.Locale)
        + (b"" if text.Text is None else encode_string(text.Text))
    )


def encode_diagnostic_info(info: Any) -> bytes:
    """A DiagnosticInfo, of which most say nothing."""
    said = (info.SymbolicId, info.NamespaceURI, info.Locale, info.LocalizedText, info.AdditionalInfo)
    if all(each is None for each in said) and info.InnerStatusCode is None and info.InnerDiagnosticInfo is None:
        return b"\x00"
    data: bytes = struct_to_binary(info)
    return data


def encode_variant(variant: Any) -> bytes:
    """A Variant."""
    value = variant.Value
    kind = variant.VariantType
    try:
        if not variant.is_array and type(value) not in (list, tuple):
            scalar = _SCALARS.get(kind)
            if scalar is not None:
                return scalar(value)
        elif (
            variant.Dimensions is None
            and value is not None
            and (code := _ARRAYS.get(kind)) is not None
            and (not value or type(value[0]) not in (list, tuple))
        ):
            return struct.pack(f"<Bi{len(value)}{code}", kind | _ARRAY, len(value), *value)
    except (struct.error, TypeError, OverflowError, AttributeError):
        pass  # asyncua says what is wrong with it
    data: bytes = variant_to_binary(variant)
    return data


def encode_content(value: Any, kind: Any) -> bytes:
    """A Variant of this content and VariantType, which for a scalar is not made at all."""
    scalar = _SCALARS.get(kind)
    if scalar is not None and type(value) not in (list, tuple):
        try:
            return scalar(value)
        except (struct.error, TypeError, OverflowError, AttributeError):
            pass  # asyncua says what is wrong with it
    return encode_variant(ua.Variant(value, kind))


def _number(kind: int, code: str) -> Callable[[Any], bytes]:
    pack, number = struct.Struct(f"<B{code}").pack, int(kind)
    return lambda value: pack(number, value)


def _prefixed(kind: int, encode: Callable[[Any], bytes]) -> Callable[[Any], bytes]:
    first = bytes((int(kind),))
    return lambda value: first + encode(value)


_ARRAYS: Final[dict[Any, str]] = {kind: NUMBERS[kind.name] for kind in ua.VariantType if kind.name in NUMBERS}
_SCALARS: Final[dict[Any, Callable[[Any], bytes]]] = {
    **{kind: _number(kind, code) for kind, code in _ARRAYS.items()},
    ua.VariantType.Null: lambda _: b"\x00",
    ua.VariantType.String: _prefixed(ua.VariantType.String, encode_string),
    ua.VariantType.ByteString: _prefixed(ua.VariantType.ByteString, encode_string),
    ua.VariantType.DateTime: _prefixed(ua.VariantType.DateTime, encode_time),
    ua.VariantType.NodeId: _prefixed(ua.VariantType.NodeId, encode_node_id),
    ua.VariantType.ExpandedNodeId: _prefixed(ua.VariantType.ExpandedNodeId, encode_node_id),
    ua.VariantType.QualifiedName: _prefixed(ua.VariantType.QualifiedName, encode_qualified_name),
    ua.VariantType.LocalizedText: _prefixed(ua.VariantType.LocalizedText, encode_localized_text),
    ua.VariantType.StatusCode: lambda code: _number(ua.VariantType.StatusCode, "I")(code.value),
}
