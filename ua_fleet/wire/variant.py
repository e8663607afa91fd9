"""Values that contain values: Variant, DataValue and DiagnosticInfo (OPC 10000-6 5.2.2.12, 5.2.2.16, 5.2.2.17)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from struct import Struct
from typing import Any, Final, cast

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, DataValue, DiagnosticInfo, Matrix, Variant
from ua_fleet.wire import builtin
from ua_fleet.wire.builtin import FIXED, Decoder, Encoder, encode_length, encode_number
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.cursor import DEEPEST_NESTING, Cursor
from ua_fleet.wire.packed import LETTERS, is_packed

__all__ = [
    "DECODERS",
    "ENCODERS",
    "NESTED_ENCODERS",
    "SMALLEST",
    "decode_data_value",
    "decode_typed",
    "decode_variant",
    "encode_data_value",
    "encode_typed",
    "encode_variant",
]

TYPE_BITS: Final = 0x3F
LAST_ASSIGNED: Final = BuiltinType.DIAGNOSTIC_INFO
LAST_RESERVED: Final = 31
"""Types 26 to 31 are not assigned; decoders take their values as ByteStrings (OPC 10000-6 table 26)."""

# Bits of a DataValue's mask (OPC 10000-6 5.2.2.17).
HAS_VALUE: Final = 0x01
HAS_STATUS: Final = 0x02
HAS_SOURCE_TIMESTAMP: Final = 0x04
HAS_SERVER_TIMESTAMP: Final = 0x08
HAS_SOURCE_PICOSECONDS: Final = 0x10
HAS_SERVER_PICOSECONDS: Final = 0x20

_INT64 = Struct("<q")


def _decode_number(layout: Struct) -> Decoder:
    def decode(cursor: Cursor) -> Any:
        return cursor.unpack(layout)[0]

    return decode


def _encode_number(kind: int) -> Encoder:
    def encode(out: bytearray, value: Any) -> None:
        encode_number(out, kind, value)

    return encode


def decode_variant(cursor: Cursor) -> Variant:
    """A Variant."""
    code = cursor.byte()
    return Variant(code, decode_typed(cursor, code))


def decode_typed(cursor: Cursor, code: int) -> Any:
    """The value that follows the encoding byte `code` of a Variant."""
    kind = code & TYPE_BITS
    if kind > LAST_RESERVED or (kind == 0 and code):
        raise RemoteWireError(Cause.VARIANT_TYPE, f"encoding byte 0x{code:02x}", cursor.position - 1)
    if code & ARRAY:
        return _decode_array(cursor, code, kind)
    if code & DIMENSIONS:
        raise RemoteWireError(Cause.DIMENSIONS_WITHOUT_ARRAY, f"encoding byte 0x{code:02x}", cursor.position - 1)
    if kind == BuiltinType.VARIANT:
        raise RemoteWireError(Cause.VARIANT_IN_VARIANT, "", cursor.position - 1)
    return DECODERS[kind](cursor)


def _decode_array(cursor: Cursor, code: int, kind: int) -> Any:
    count = cursor.length(SMALLEST[kind])
    elements: tuple[Any, ...] = ()
    if count:
        layout = FIXED.get(kind)
        if layout is not None:
            elements = cursor.unpack(Struct(f"<{count}{layout.format[1:]}"))
        else:
            decode = DECODERS[kind]
            cursor.count_elements(count, SMALLEST[kind])
            cursor.descend()
            elements = tuple([decode(cursor) for _ in range(count)])
            cursor.ascend()
    if not code & DIMENSIONS:
        return None if count is None else elements
    start = cursor.position
    dimensions = cursor.unpack(Struct(f"<{cursor.length(4) or 0}i"))
    if _product(dimensions, len(elements)) != len(elements):
        raise RemoteWireError(Cause.ARRAY_DIMENSIONS, f"{len(elements)} elements do not fill them", start)
    return Matrix(elements, dimensions)


def _product(dimensions: tuple[int, ...], limit: int) -> int:
    """How many elements the dimensions hold; some number above `limit` where it is more."""
    if not dimensions or min(dimensions) <= 0:
        return 0
    product = 1
    for dimension in dimensions:
        product *= dimension
        if product > limit:
            break
    return product


def encode_variant(out: bytearray, value: Any, depth: int = 0) -> None:
    """Append a Variant."""
    if not isinstance(value, Variant):
        raise LocalWireError(f"{value!r:.80} is no Variant")
    encode_typed(out, value.type, value.value, depth)


def encode_typed(out: bytearray, code: int, value: Any, depth: int = 0) -> None:
    """Append a Variant: its encoding byte `code`, then `value`."""
    kind = code & TYPE_BITS
    if kind > LAST_ASSIGNED or code > 0xFF or (kind == 0 and code):
        raise LocalWireError(f"0x{code:02x} is no type code")
    if code & ARRAY:
        _encode_array(out, code, value, depth)
        return
    if code & DIMENSIONS or kind == BuiltinType.VARIANT:
        raise LocalWireError(f"0x{code:02x} is no type code of a Variant")
    out.append(code)
    _encode_element(out, kind, value, depth)


def _encode_element(out: bytearray, kind: int, value: Any, depth: int) -> None:
    nested = NESTED_ENCODERS.get(kind)
    if nested is None:
        ENCODERS[kind](out, value)
    elif depth >= DEEPEST_NESTING:
        raise LocalWireError(f"values nested deeper than {DEEPEST_NESTING} levels")
    else:
        nested(out, value, depth + 1)


def _encode_array(out: bytearray, code: int, value: Any, depth: int) -> None:
    kind = code & TYPE_BITS
    elements: Any = value
    dimensions: tuple[int, ...] = ()
    if code & DIMENSIONS:
        if not isinstance(value, Matrix):
            raise LocalWireError(f"{value!r:.80} is no Matrix")
        elements, dimensions = value
        if _product(dimensions, len(elements)) != len(elements):
            raise LocalWireError(f"{len(elements)} elements do not fill the dimensions {dimensions}")
        if len(dimensions) < 2 or not elements:  # then no dimensions may stand there (OPC 10000-6 5.2.2.16)
            code, dimensions = code & ~DIMENSIONS, ()
    out.append(code)
    if elements is None:
        encode_length(out, -1)
    elif is_packed(elements, LETTERS.get(kind, "")):
        encode_length(out, len(elements))
        out += elements.cast("B")
    elif not isinstance(elements, tuple | list):
        raise LocalWireError(f"{value!r:.80} is no array")
    else:
        items = cast("Sequence[Any]", elements)
        encode_length(out, len(items))
        _encode_elements(out, kind, items, depth)
    if dimensions:
        encode_length(out, len(dimensions))
        _encode_elements(out, BuiltinType.INT32, dimensions, depth)


def _encode_elements(out: bytearray, kind: int, elements: Sequence[Any], depth: int) -> None:
    layout = FIXED.get(kind)
    if layout is None or kind == BuiltinType.BOOLEAN:
        for element in elements:
            _encode_element(out, kind, element, depth)
        return
    try:
        out += struct.pack(f"<{len(elements)}{layout.format[1:]}", *elements)
    except (struct.error, OverflowError) as error:
        raise LocalWireError(f"an element does not fit into {BuiltinType(kind).name}: {error}") from None


def decode_data_value(cursor: Cursor) -> DataValue:
    """A DataValue."""
    mask = cursor.byte()
    if mask & 0xC0:
        raise RemoteWireError(Cause.RESERVED_MASK_BITS, f"DataValue mask 0x{mask:02x}", cursor.position - 1)
    cursor.descend()
    variant = decode_variant(cursor) if mask & HAS_VALUE else None
    cursor.ascend()
    status = cursor.uint32() if mask & HAS_STATUS else 0
    source_timestamp = cursor.unpack(_INT64)[0] if mask & HAS_SOURCE_TIMESTAMP else None
    source_picoseconds = cursor.uint16() if mask & HAS_SOURCE_PICOSECONDS else None
    server_timestamp = cursor.unpack(_INT64)[0] if mask & HAS_SERVER_TIMESTAMP else None
    server_picoseconds = cursor.uint16() if mask & HAS_SERVER_PICOSECONDS else None
    return DataValue(variant, status, source_timestamp, server_timestamp, source_picoseconds, server_picoseconds)


def encode_data_value(out: bytearray, value: Any, depth: int = 0) -> None:
    """Append a DataValue; a Good status is left out."""
    if not isinstance(value, DataValue):
        raise LocalWireError(f"{value!r:.80} is no DataValue")
    parts = (
        (value.source_timestamp, HAS_SOURCE_TIMESTAMP, BuiltinType.DATETIME),
        (value.source_picoseconds, HAS_SOURCE_PICOSECONDS, BuiltinType.UINT16),
        (value.server_timestamp, HAS_SERVER_TIMESTAMP, BuiltinType.DATETIME),
        (value.server_picoseconds, HAS_SERVER_PICOSECONDS, BuiltinType.UINT16),
    )
    mask = sum(bit for part, bit, _ in parts if part is not None)
    mask |= (HAS_VALUE if value.variant is not None else 0) | (HAS_STATUS if value.status else 0)
    out.append(mask)
    if value.variant is not None:
        encode_variant(out, value.variant, depth)
    if value.status:
        encode_number(out, BuiltinType.STATUS_CODE, value.status)
    for part, _, kind in parts:
        if part is not None:
            encode_number(out, kind, part)


def decode_diagnostic_info(cursor: Cursor) -> DiagnosticInfo:
    """A DiagnosticInfo."""
    mask = cursor.byte()
    if mask & 0x80:
        raise RemoteWireError(Cause.RESERVED_MASK_BITS, f"DiagnosticInfo mask 0x{mask:02x}", cursor.position - 1)
    symbolic_id = cursor.int32() if mask & 0x01 else None
    namespace_uri = cursor.int32() if mask & 0x02 else None
    locale = cursor.int32() if mask & 0x08 else None
    localized_text = cursor.int32() if mask & 0x04 else None
    additional_info = builtin.decode_string(cursor) if mask & 0x10 else None
    inner_status = cursor.uint32() if mask & 0x20 else None
    inner = None
    if mask & 0x40:
        cursor.descend()
        inner = decode_diagnostic_info(cursor)
        cursor.ascend()
    return DiagnosticInfo(symbolic_id, namespace_uri, localized_text, locale, additional_info, inner_status, inner)


def encode_diagnostic_info(out: bytearray, value: Any, depth: int = 0) -> None:
    """Append a DiagnosticInfo."""
    if not isinstance(value, DiagnosticInfo):
        raise LocalWireError(f"{value!r:.80} is no DiagnosticInfo")
    parts = (
        (value.symbolic_id, 0x01, BuiltinType.INT32),
        (value.namespace_uri, 0x02, BuiltinType.INT32),
        (value.locale, 0x08, BuiltinType.INT32),
        (value.localized_text, 0x04, BuiltinType.INT32),
        (value.additional_info, 0x10, BuiltinType.STRING),
        (value.inner_status, 0x20, BuiltinType.STATUS_CODE),
        (value.inner, 0x40, BuiltinType.DIAGNOSTIC_INFO),
    )
    out.append(sum(bit for part, bit, _ in parts if part is not None))
    for part, _, kind in parts:
        if part is not None:
            _encode_element(out, kind, part, depth)


def _decode_null(_cursor: Cursor) -> None:
    return None


def _encode_null(_out: bytearray, value: Any) -> None:
    if value is not None:
        raise LocalWireError(f"{value!r:.80} is not null")


NESTED_ENCODERS: Final[dict[int, Callable[[bytearray, Any, int], None]]] = {
    BuiltinType.DATA_VALUE: encode_data_value,
    BuiltinType.VARIANT: encode_variant,
    BuiltinType.DIAGNOSTIC_INFO: encode_diagnostic_info,
}

DECODERS: Final[dict[int, Decoder]] = {
    BuiltinType.NULL: _decode_null,
    **{kind: _decode_number(layout) for kind, layout in FIXED.items()},
    BuiltinType.STRING: builtin.decode_string,
    BuiltinType.GUID: builtin.decode_guid,
    BuiltinType.BYTE_STRING: builtin.decode_byte_string,
    BuiltinType.XML_ELEMENT: builtin.decode_string,
    BuiltinType.NODE_ID: builtin.decode_node_id,
    BuiltinType.EXPANDED_NODE_ID: builtin.decode_expanded_node_id,
    BuiltinType.QUALIFIED_NAME: builtin.decode_qualified_name,
    BuiltinType.LOCALIZED_TEXT: builtin.decode_localized_text,
    BuiltinType.EXTENSION_OBJECT: builtin.decode_extension_object,
    BuiltinType.DATA_VALUE: decode_data_value,
    BuiltinType.VARIANT: decode_variant,
    BuiltinType.DIAGNOSTIC_INFO: decode_diagnostic_info,
    **dict.fromkeys(range(LAST_ASSIGNED + 1, LAST_RESERVED + 1), builtin.decode_byte_string),
}
"""Decoder of a scalar of each type."""

ENCODERS: Final[dict[int, Encoder]] = {
    BuiltinType.NULL: _encode_null,
    **{kind: _encode_number(kind) for kind in FIXED},
    BuiltinType.STRING: builtin.encode_string,
    BuiltinType.GUID: builtin.encode_guid,
    BuiltinType.BYTE_STRING: builtin.encode_byte_string,
    BuiltinType.XML_ELEMENT: builtin.encode_string,
    BuiltinType.NODE_ID: builtin.encode_node_id,
    BuiltinType.EXPANDED_NODE_ID: builtin.encode_expanded_node_id,
    BuiltinType.QUALIFIED_NAME: builtin.encode_qualified_name,
    BuiltinType.LOCALIZED_TEXT: builtin.encode_localized_text,
    BuiltinType.EXTENSION_OBJECT: builtin.encode_extension_object,
}
"""Encoder of a scalar of each type that does not nest."""

SMALLEST: Final[dict[int, int]] = {
    **{kind: layout.size for kind, layout in FIXED.items()},
    BuiltinType.STRING: 4,
    BuiltinType.GUID: 16,
    BuiltinType.BYTE_STRING: 4,
    BuiltinType.XML_ELEMENT: 4,
    BuiltinType.NODE_ID: 2,
    BuiltinType.EXPANDED_NODE_ID: 2,
    BuiltinType.QUALIFIED_NAME: 6,
    BuiltinType.LOCALIZED_TEXT: 1,
    BuiltinType.EXTENSION_OBJECT: 3,
    BuiltinType.DATA_VALUE: 1,
    BuiltinType.VARIANT: 1,
    BuiltinType.DIAGNOSTIC_INFO: 1,
    **dict.fromkeys(range(LAST_ASSIGNED + 1, LAST_RESERVED + 1), 4),
}
"""Bytes that an element of an array takes at least."""
