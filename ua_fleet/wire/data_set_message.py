"""DataSetMessages: header and fields (OPC 10000-14 7.2.4.5, tables 162 to 166)."""

from __future__ import annotations

from collections.abc import Iterable
from struct import Struct
from typing import Any, Final

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType, DataValue, Variant
from ua_fleet.wire.builtin import encode_number
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.messages import DataSetMessage, FieldEncoding, FrameKind
from ua_fleet.wire.variant import decode_data_value, decode_variant, encode_data_value, encode_typed

__all__ = [
    "decode_data_set_head",
    "decode_data_set_message",
    "decode_fields",
    "encode_data_set_message",
    "with_data_values",
]

# DataSetFlags1
IS_VALID: Final = 0x01
FIELD_ENCODING_BITS: Final = 0x06
HAS_SEQUENCE_NUMBER: Final = 0x08
HAS_STATUS: Final = 0x10
HAS_MAJOR_VERSION: Final = 0x20
HAS_MINOR_VERSION: Final = 0x40
HAS_FLAGS_2: Final = 0x80
# DataSetFlags2
FRAME_KIND_BITS: Final = 0x0F
HAS_TIMESTAMP: Final = 0x10
HAS_PICOSECONDS: Final = 0x20
RESERVED_FLAGS_2: Final = 0xC0
FIRST_ACTION_KIND: Final = 5
LAST_ACTION_KIND: Final = 6
"""DataSetMessage types of Action requests and responses (`actions.py`); 4 is none (table 162)."""

_INT64 = Struct("<q")


def decode_data_set_message(cursor: Cursor, data_set_writer_id: int) -> DataSetMessage:
    """Decode the DataSetMessage that fills the cursor, padding included."""
    message = decode_data_set_head(cursor, data_set_writer_id)
    kind, encoding = message.kind, message.encoding
    if not message.valid:
        return message
    if kind > FrameKind.KEEP_ALIVE:
        detail = f"DataSetMessage type {kind} without an ActionHeader"
        raise RemoteWireError(Cause.ACTION_HEADER_MISSING, detail, cursor.position)
    if kind == FrameKind.KEEP_ALIVE:
        cursor.expect_padding()
        return message
    if kind == FrameKind.EVENT and encoding != FieldEncoding.VARIANT:
        raise RemoteWireError(Cause.EVENT_ENCODING, f"field encoding {encoding} in an event", cursor.position)
    if encoding == FieldEncoding.RAW_DATA:
        return message._replace(raw=cursor.take(cursor.remaining))
    if kind == FrameKind.KEY and not cursor.remaining:  # a heartbeat is the header alone (7.2.4.5.5)
        return message
    message = decode_fields(cursor, message)
    cursor.expect_padding()
    return message


def decode_data_set_head(cursor: Cursor, data_set_writer_id: int) -> DataSetMessage:
    """Decode the header of a DataSetMessage of any type; one that is not valid is read to the end."""
    flags1 = cursor.byte()
    if not flags1 & IS_VALID:  # then the rest is not to be looked at (table 162)
        cursor.position = cursor.end
        return DataSetMessage(data_set_writer_id, valid=False)
    flags2 = cursor.byte() if flags1 & HAS_FLAGS_2 else 0
    encoding = (flags1 & FIELD_ENCODING_BITS) >> 1
    if encoding > FieldEncoding.DATA_VALUE:
        raise RemoteWireError(Cause.RESERVED_FIELD_ENCODING, f"DataSetFlags1 0x{flags1:02x}", cursor.position)
    if flags2 & RESERVED_FLAGS_2:
        raise RemoteWireError(Cause.RESERVED_DATA_SET_FLAGS, f"DataSetFlags2 0x{flags2:02x}", cursor.position)
    kind = flags2 & FRAME_KIND_BITS
    if kind > FrameKind.KEEP_ALIVE and not FIRST_ACTION_KIND <= kind <= LAST_ACTION_KIND:
        raise RemoteWireError(Cause.RESERVED_FRAME_KIND, f"DataSetMessage type {kind}", cursor.position)
    return DataSetMessage(
        data_set_writer_id,
        kind=kind,
        sequence_number=cursor.uint16() if flags1 & HAS_SEQUENCE_NUMBER else None,
        timestamp=cursor.unpack(_INT64)[0] if flags2 & HAS_TIMESTAMP else None,
        picoseconds=cursor.uint16() if flags2 & HAS_PICOSECONDS else None,
        status=cursor.uint16() << 16 if flags1 & HAS_STATUS else None,
        major_version=cursor.uint32() if flags1 & HAS_MAJOR_VERSION else None,
        minor_version=cursor.uint32() if flags1 & HAS_MINOR_VERSION else None,
        encoding=encoding,
    )


def decode_fields(cursor: Cursor, message: DataSetMessage) -> DataSetMessage:
    """The message with the fields that follow its header: a count, then Variants or DataValues."""
    count = cursor.uint16()
    is_delta = message.kind == FrameKind.DELTA
    smallest = 3 if is_delta else 1
    if count * smallest > cursor.remaining:
        detail = f"{count} fields announced, {cursor.remaining} bytes left"
        raise RemoteWireError(Cause.LENGTH_BEYOND_END, detail, cursor.position - 2)
    indices: list[int] = []
    fields: list[Any] = []
    decode = decode_data_value if message.encoding == FieldEncoding.DATA_VALUE else decode_variant
    for _ in range(count):
        if is_delta:
            indices.append(cursor.uint16())
        fields.append(decode(cursor))
    if is_delta:
        if len(set(indices)) != count:
            raise RemoteWireError(Cause.REPEATED_FIELD_INDEX, "a delta frame names a field twice", cursor.position)
        message = message._replace(indices=tuple(indices))
    if message.encoding == FieldEncoding.DATA_VALUE:
        return with_data_values(message, fields)
    return message._replace(
        types=tuple([field.type for field in fields]), values=tuple([field.value for field in fields])
    )


def with_data_values(message: DataSetMessage, fields: Iterable[DataValue]) -> DataSetMessage:
    """The message with these DataValues as its fields: what stands beside a value goes to the `field_*` tuples."""
    variants, statuses, *columns = tuple(zip(*fields, strict=True)) or ((),) * 6
    source, server, source_pico, server_pico = (
        column if any(item is not None for item in column) else None for column in columns
    )
    variants = [Variant(0, None) if variant is None else variant for variant in variants]
    return message._replace(
        types=tuple([variant.type for variant in variants]),
        values=tuple([variant.value for variant in variants]),
        encoding=FieldEncoding.DATA_VALUE.value,
        field_status=statuses,
        field_source_timestamps=source,
        field_server_timestamps=server,
        field_source_picoseconds=source_pico,
        field_server_picoseconds=server_pico,
    )


def encode_data_set_message(out: bytearray, message: DataSetMessage) -> None:
    """Append a DataSetMessage, header first."""
    if not message.valid:
        out.append(0)
        return
    encoding, kind = message.encoding, message.kind
    if not 0 <= encoding <= FieldEncoding.DATA_VALUE or not 0 <= kind <= FrameKind.KEEP_ALIVE:
        raise LocalWireError(f"no such field encoding ({encoding}) or kind of DataSetMessage ({kind})")
    flags2 = kind
    flags2 |= HAS_TIMESTAMP if message.timestamp is not None else 0
    flags2 |= HAS_PICOSECONDS if message.picoseconds is not None else 0
    flags1 = IS_VALID | encoding << 1
    flags1 |= HAS_SEQUENCE_NUMBER if message.sequence_number is not None else 0
    flags1 |= HAS_STATUS if message.status is not None else 0
    flags1 |= HAS_MAJOR_VERSION if message.major_version is not None else 0
    flags1 |= HAS_MINOR_VERSION if message.minor_version is not None else 0
    flags1 |= HAS_FLAGS_2 if flags2 else 0
    out.append(flags1)
    if flags2:
        out.append(flags2)
    for part, part_type in (
        (message.sequence_number, BuiltinType.UINT16),
        (message.timestamp, BuiltinType.DATETIME),
        (message.picoseconds, BuiltinType.UINT16),
        (None if message.status is None else message.status >> 16, BuiltinType.UINT16),
        (message.major_version, BuiltinType.UINT32),
        (message.minor_version, BuiltinType.UINT32),
    ):
        if part is not None:
            encode_number(out, part_type, part)
    if kind == FrameKind.KEEP_ALIVE:
        if message.types or message.values:
            raise LocalWireError("a keep-alive has no fields")
    elif encoding == FieldEncoding.RAW_DATA:
        if message.raw is None:
            raise LocalWireError("a RawData message without its `raw` bytes")
        out += message.raw
    elif message.types or message.values or kind != FrameKind.KEY:  # no fields in a key frame: a heartbeat
        _encode_fields(out, message)


def _encode_fields(out: bytearray, message: DataSetMessage) -> None:
    count = len(message.types)
    if len(message.values) != count:
        raise LocalWireError(f"{count} types for {len(message.values)} values")
    encode_number(out, BuiltinType.UINT16, count)
    indices = message.indices
    if (indices is not None) != (message.kind == FrameKind.DELTA):
        raise LocalWireError("a delta frame has field indices, other frames have none")
    if indices is not None and (len(indices) != count or len(set(indices)) != count):
        raise LocalWireError(f"{len(set(indices))} different indices for {count} fields")
    if message.encoding == FieldEncoding.VARIANT:
        for position, (code, value) in enumerate(zip(message.types, message.values, strict=True)):
            if indices is not None:
                encode_number(out, BuiltinType.UINT16, indices[position])
            encode_typed(out, code, value)
        return
    if message.kind == FrameKind.EVENT:
        raise LocalWireError("the fields of an event are Variants")
    for position, field in enumerate(_data_values(message)):
        if indices is not None:
            encode_number(out, BuiltinType.UINT16, indices[position])
        encode_data_value(out, field)


def _data_values(message: DataSetMessage) -> list[DataValue]:
    """The fields of a message in DataValue encoding, put together again. A field of type 0 has no value."""
    count = len(message.types)
    variants = [
        Variant(code, value) if code else None for code, value in zip(message.types, message.values, strict=True)
    ]
    columns: list[tuple[Any, ...]] = [
        (default,) * count if column is None else column
        for column, default in (
            (message.field_status, 0),
            (message.field_source_timestamps, None),
            (message.field_server_timestamps, None),
            (message.field_source_picoseconds, None),
            (message.field_server_picoseconds, None),
        )
    ]
    if any(len(column) != count for column in columns):
        raise LocalWireError(f"a field_* tuple does not have {count} items")
    return [DataValue(*parts) for parts in zip(variants, *columns, strict=True)]
