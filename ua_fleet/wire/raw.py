"""RawData: fields without types, laid out as their metadata says (OPC 10000-14 7.2.4.5.11)."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import Any, Final, cast

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, Matrix
from ua_fleet.wire.builtin import encode_length
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.cursor import DEEPEST_NESTING, Cursor
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData, FieldEncoding, FieldMetaData, FrameKind
from ua_fleet.wire.packed import LETTERS, is_packed
from ua_fleet.wire.variant import DECODERS, ENCODERS, SMALLEST

__all__ = ["decode_raw_fields", "encode_raw_field"]

PADDED: Final = (BuiltinType.STRING, BuiltinType.BYTE_STRING)
"""The types that are padded with zeros up to MaxStringLength."""

FORBIDDEN: Final = frozenset(
    {
        BuiltinType.NULL,
        BuiltinType.XML_ELEMENT,
        BuiltinType.NODE_ID,
        BuiltinType.EXPANDED_NODE_ID,
        BuiltinType.QUALIFIED_NAME,
        BuiltinType.LOCALIZED_TEXT,
        BuiltinType.EXTENSION_OBJECT,
        BuiltinType.DATA_VALUE,
        BuiltinType.VARIANT,
        BuiltinType.DIAGNOSTIC_INFO,
    }
)
"""Not allowed in RawData, or (ExtensionObject: structures) not readable without a description of the type."""


def decode_raw_fields(message: DataSetMessage, metadata: DataSetMetaData) -> DataSetMessage:
    """The message with its `raw` bytes decoded into `types` and `values`; raises RemoteWireError.

    A message without raw bytes, or with those of another encoding (JSON), is returned as it is. Whether the metadata is
    of the right version is the caller's to know.
    """
    if message.raw is None or message.encoding != FieldEncoding.RAW_DATA:
        return message
    cursor = Cursor(message.raw)
    if message.kind == FrameKind.DELTA:
        return _decode_delta(cursor, message, metadata)
    fields = metadata.fields
    values = [_decode_field(cursor, field) for field in fields]
    cursor.expect_padding()
    return message._replace(types=tuple([_type_code(field) for field in fields]), values=tuple(values), raw=None)


def _decode_delta(cursor: Cursor, message: DataSetMessage, metadata: DataSetMetaData) -> DataSetMessage:
    fields: dict[int, Any] = {}
    for _ in range(cursor.uint16()):
        index = cursor.uint16()
        if index >= len(metadata.fields) or index in fields:
            raise RemoteWireError(Cause.RAW_FIELD_INDEX, f"field {index} of {len(metadata.fields)}", cursor.position)
        fields[index] = _decode_field(cursor, metadata.fields[index])
    cursor.expect_padding()
    return message._replace(
        indices=tuple(fields),
        types=tuple([_type_code(metadata.fields[index]) for index in fields]),
        values=tuple(fields.values()),
        raw=None,
    )


def _type_code(field: FieldMetaData) -> int:
    if field.value_rank < 0:
        return field.builtin_type
    return field.builtin_type | ARRAY | (DIMENSIONS if field.value_rank > 1 else 0)


def _decode_field(cursor: Cursor, field: FieldMetaData) -> Any:
    if field.builtin_type in FORBIDDEN or field.builtin_type > BuiltinType.DIAGNOSTIC_INFO:
        raise RemoteWireError(
            Cause.RAW_TYPE, f"field {field.name!r:.80} has type {field.builtin_type}", cursor.position
        )
    if field.value_rank == -1:
        return _decode_element(cursor, field)
    if field.value_rank == 1:
        return _decode_array(cursor, field)
    if 1 < field.value_rank <= DEEPEST_NESTING:
        return _decode_matrix(cursor, field)
    raise RemoteWireError(Cause.RAW_RANK, f"field {field.name!r:.80} has ValueRank {field.value_rank}", cursor.position)


def _element_size(field: FieldMetaData) -> int:
    """Bytes of an element with its padding, where it has a fixed size."""
    size = SMALLEST[field.builtin_type]
    return size + field.max_string_length if field.builtin_type in PADDED else size


def _decode_element(cursor: Cursor, field: FieldMetaData) -> Any:
    start = cursor.position
    value = DECODERS[field.builtin_type](cursor)
    if field.builtin_type in PADDED and field.max_string_length:
        _pass_padding(cursor, start + _element_size(field) - cursor.position, field)
    return value


def _decode_array(cursor: Cursor, field: FieldMetaData) -> tuple[Any, ...] | None:
    start = cursor.position
    count = cursor.length(SMALLEST[field.builtin_type])
    values = tuple([_decode_element(cursor, field) for _ in range(count or 0)])
    if field.array_dimensions and field.array_dimensions[0]:
        _pass_padding(cursor, start + 4 + field.array_dimensions[0] * _element_size(field) - cursor.position, field)
    return None if count is None else values


def _decode_matrix(cursor: Cursor, field: FieldMetaData) -> Matrix:
    """An inline matrix (OPC 10000-6 5.2.5): its dimensions, then the elements, each dimension padded to its maximum."""
    dimensions = tuple([cursor.int32() for _ in range(cursor.length(4) or 0)])
    if len(dimensions) != field.value_rank or min(dimensions) < 0:
        detail = f"field {field.name!r:.80} has dimensions {dimensions!s:.80}"
        raise RemoteWireError(Cause.ARRAY_DIMENSIONS, detail, cursor.position)
    largest = field.array_dimensions
    if len(largest) != len(dimensions) or not all(largest):  # then there is no maximum to pad up to
        largest = dimensions
    if any(length > most for length, most in zip(dimensions, largest, strict=True)):
        detail = f"field {field.name!r:.80} has dimensions {dimensions}, its metadata allows {largest}"
        raise RemoteWireError(Cause.RAW_TOO_LONG, detail, cursor.position)
    values: list[Any] = []
    if all(dimensions):
        _decode_rows(cursor, field, dimensions, largest, values)
    else:
        _pass_padding(cursor, prod(largest) * _element_size(field), field)
    return Matrix(tuple(values), dimensions)


def _decode_rows(
    cursor: Cursor, field: FieldMetaData, dimensions: tuple[int, ...], largest: tuple[int, ...], values: list[Any]
) -> None:
    """The elements of one dimension and those inside it, row after row, each padded to its largest size."""
    start = cursor.position
    for _ in range(dimensions[0]):
        if len(dimensions) == 1:
            values.append(_decode_element(cursor, field))
        else:
            _decode_rows(cursor, field, dimensions[1:], largest[1:], values)
    _pass_padding(cursor, start + prod(largest) * _element_size(field) - cursor.position, field)


def _pass_padding(cursor: Cursor, size: int, field: FieldMetaData) -> None:
    if size < 0:
        detail = f"field {field.name!r:.80} is {-size} bytes longer than its metadata allows"
        raise RemoteWireError(Cause.RAW_TOO_LONG, detail, cursor.position)
    if cursor.take(size).strip(b"\0"):
        raise RemoteWireError(
            Cause.RAW_PADDING, f"field {field.name!r:.80} is padded with other bytes than 0", cursor.position
        )


def encode_raw_field(field: FieldMetaData, value: Any) -> bytes:
    """A field of a RawData message, padded to the maxima of its metadata.

    Raises:
        LocalWireError: a type or ValueRank that RawData cannot have, or a value that does not fit.
    """
    kind, rank = field.builtin_type, field.value_rank
    if kind in FORBIDDEN or kind > BuiltinType.DIAGNOSTIC_INFO:
        raise LocalWireError(f"field {field.name!r:.80} has type {kind}, which RawData cannot have")
    out = bytearray()
    if rank == -1:
        _encode_element(out, field, value)
    elif rank == 1:
        _encode_array(out, field, value)
    elif 1 < rank <= DEEPEST_NESTING:
        _encode_matrix(out, field, value)
    else:
        raise LocalWireError(f"field {field.name!r:.80} has ValueRank {rank}, which RawData cannot have")
    return bytes(out)


def _encode_element(out: bytearray, field: FieldMetaData, value: Any) -> None:
    start = len(out)
    ENCODERS[field.builtin_type](out, value)
    if field.builtin_type in PADDED and field.max_string_length:
        _pad(out, start + _element_size(field), field)


def _encode_array(out: bytearray, field: FieldMetaData, value: Any) -> None:
    start = len(out)
    if value is None:
        encode_length(out, -1)
    elif is_packed(value, LETTERS.get(field.builtin_type, "")):
        encode_length(out, len(value))
        out += value.cast("B")
    elif isinstance(value, tuple):
        elements = cast("Sequence[Any]", value)
        encode_length(out, len(elements))
        for element in elements:
            _encode_element(out, field, element)
    else:
        raise LocalWireError(f"field {field.name!r:.80}: {value!r:.80} is no array")
    if field.array_dimensions and field.array_dimensions[0]:
        _pad(out, start + 4 + field.array_dimensions[0] * _element_size(field), field)


def _encode_matrix(out: bytearray, field: FieldMetaData, value: Any) -> None:
    if not isinstance(value, Matrix) or len(value.dimensions) != field.value_rank:
        raise LocalWireError(f"field {field.name!r:.80}: {value!r:.80} is no matrix of {field.value_rank} dimensions")
    elements, dimensions = value
    if prod(dimensions) != len(elements):
        raise LocalWireError(f"field {field.name!r:.80}: {len(elements)} elements do not fill {dimensions}")
    encode_length(out, len(dimensions))
    for length in dimensions:
        encode_length(out, length)
    largest = field.array_dimensions
    if len(largest) != len(dimensions) or not all(largest):  # then there is no maximum to pad up to
        largest = dimensions
    if any(length > most for length, most in zip(dimensions, largest, strict=True)):
        raise LocalWireError(f"field {field.name!r:.80} has dimensions {dimensions}, its metadata allows {largest}")
    if elements:
        _encode_rows(out, field, tuple(elements), dimensions, largest)
    else:
        out += bytes(prod(largest) * _element_size(field))


def _encode_rows(
    out: bytearray,
    field: FieldMetaData,
    elements: tuple[Any, ...],
    dimensions: tuple[int, ...],
    largest: tuple[int, ...],
) -> None:
    start, step = len(out), len(elements) // dimensions[0]
    for row in range(dimensions[0]):
        if len(dimensions) == 1:
            _encode_element(out, field, elements[row])
        else:
            part = elements[row * step : (row + 1) * step]
            _encode_rows(out, field, part, dimensions[1:], largest[1:])
    _pad(out, start + prod(largest) * _element_size(field), field)


def _pad(out: bytearray, end: int, field: FieldMetaData) -> None:
    if len(out) > end:
        raise LocalWireError(f"field {field.name!r:.80} is {len(out) - end} bytes longer than its metadata allows")
    out += bytes(end - len(out))
