"""The header of a UADP NetworkMessage (OPC 10000-14 7.2.4.4.2, table 154)."""

from __future__ import annotations

import struct
import uuid
from enum import IntEnum
from struct import Struct
from typing import Final, NamedTuple

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType, Variant
from ua_fleet.wire.builtin import (
    FIXED,
    decode_guid,
    decode_string,
    encode_guid,
    encode_number,
    encode_string,
)
from ua_fleet.wire.causes import Cause, SecuredMessage
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.messages import NetworkMessage, PublisherIdType
from ua_fleet.wire.variant import decode_variant, encode_typed

__all__ = [
    "Header",
    "MessageType",
    "check_discovery_flags",
    "decode_flags",
    "decode_group_header",
    "decode_header",
    "decode_message_type",
    "decode_publisher_id",
    "encode_discovery_header",
    "encode_header",
    "encode_publisher_id",
]

UADP_VERSION: Final = 1

# UADPFlags
HAS_PUBLISHER_ID: Final = 0x10
HAS_GROUP_HEADER: Final = 0x20
HAS_PAYLOAD_HEADER: Final = 0x40
HAS_EXTENDED_FLAGS_1: Final = 0x80
# ExtendedFlags1
PUBLISHER_ID_TYPE_BITS: Final = 0x07
HAS_DATA_SET_CLASS_ID: Final = 0x08
HAS_SECURITY_HEADER: Final = 0x10
HAS_TIMESTAMP: Final = 0x20
HAS_PICOSECONDS: Final = 0x40
HAS_EXTENDED_FLAGS_2: Final = 0x80
# ExtendedFlags2
IS_CHUNK: Final = 0x01
HAS_PROMOTED_FIELDS: Final = 0x02
MESSAGE_TYPE_BITS: Final = 0x1C
HAS_ACTION_HEADER: Final = 0x20
RESERVED_EXTENDED_FLAGS_2: Final = 0xC0
# GroupFlags
HAS_WRITER_GROUP_ID: Final = 0x01
HAS_GROUP_VERSION: Final = 0x02
HAS_NETWORK_MESSAGE_NUMBER: Final = 0x04
HAS_SEQUENCE_NUMBER: Final = 0x08
RESERVED_GROUP_FLAGS: Final = 0xF0

PUBLISHER_ID_BUILTIN: Final[dict[int, BuiltinType]] = {
    PublisherIdType.BYTE: BuiltinType.BYTE,
    PublisherIdType.UINT16: BuiltinType.UINT16,
    PublisherIdType.UINT32: BuiltinType.UINT32,
    PublisherIdType.UINT64: BuiltinType.UINT64,
}
NO_SECURITY: Final = bytes(6)
"""A security header with all flags 0, no token and no nonce (table 154), as discovery messages have it."""

_INT64 = Struct("<q")


class MessageType(IntEnum):
    """UADP NetworkMessage type: bits 2 to 4 of ExtendedFlags2."""

    DATA_SET = 0
    PROBE = 1
    ANNOUNCEMENT = 2


class Header(NamedTuple):
    """What precedes the payload; the fields of NetworkMessage, and what only the decoder needs."""

    message_type: MessageType
    publisher_id: int | str | None
    publisher_id_type: int
    data_set_class_id: uuid.UUID | None
    writer_group_id: int | None
    group_version: int | None
    network_message_number: int | None
    sequence_number: int | None
    data_set_writer_ids: tuple[int, ...] | None
    """None without a payload header."""
    timestamp: int | None
    picoseconds: int | None
    promoted_types: tuple[int, ...] | None
    promoted_values: tuple[object, ...] | None
    has_action_header: bool
    """An ActionHeader is the next to be decoded (`actions.py`)."""


def decode_header(cursor: Cursor) -> Header:
    """Decode up to the payload or ActionHeader. Refused is what has to be opened before: secured messages, chunks."""
    flags, extended1, extended2 = decode_flags(cursor)
    message_type = decode_message_type(extended2)
    if message_type is not MessageType.DATA_SET:
        check_discovery_flags(flags, extended1, extended2)
    elif extended1 & HAS_SECURITY_HEADER:
        raise SecuredMessage("a DataSetMessage with the security flag", 1)
    publisher_id: int | str | None = None
    publisher_id_type = PublisherIdType.UINT16.value
    if flags & HAS_PUBLISHER_ID:
        publisher_id, publisher_id_type = decode_publisher_id(cursor, extended1)
    data_set_class_id = decode_guid(cursor) if extended1 & HAS_DATA_SET_CLASS_ID else None
    group = decode_group_header(cursor) if flags & HAS_GROUP_HEADER else (None, None, None, None)
    data_set_writer_ids = None
    if extended1 & HAS_SECURITY_HEADER:  # a discovery message, in which it follows the PublisherId
        _pass_security_header(cursor)
    if extended2 & IS_CHUNK:
        raise RemoteWireError(Cause.CHUNK, "a chunk that was not put together with the others", 2)
    if flags & HAS_PAYLOAD_HEADER:
        data_set_writer_ids = cursor.unpack(Struct(f"<{cursor.byte()}H"))
    timestamp = cursor.unpack(_INT64)[0] if extended1 & HAS_TIMESTAMP else None
    picoseconds = cursor.uint16() if extended1 & HAS_PICOSECONDS else None
    promoted_types = promoted_values = None
    if extended2 & HAS_PROMOTED_FIELDS:
        promoted_types, promoted_values = _decode_promoted_fields(cursor, data_set_writer_ids)
    if data_set_writer_ids is not None and not data_set_writer_ids:
        raise RemoteWireError(Cause.NO_DATA_SET_MESSAGE, "a payload header with count 0", cursor.position)
    return Header(
        message_type,
        publisher_id,
        publisher_id_type,
        data_set_class_id,
        *group,
        data_set_writer_ids,
        timestamp,
        picoseconds,
        promoted_types,
        promoted_values,
        bool(extended2 & HAS_ACTION_HEADER),
    )


def decode_flags(cursor: Cursor) -> tuple[int, int, int]:
    """UADPFlags, ExtendedFlags1 and ExtendedFlags2, 0 where they are absent."""
    flags = cursor.byte()
    if flags & 0x0F != UADP_VERSION:
        raise RemoteWireError(Cause.UADP_VERSION, f"version {flags & 0x0F}", 0)
    extended1 = cursor.byte() if flags & HAS_EXTENDED_FLAGS_1 else 0
    extended2 = cursor.byte() if extended1 & HAS_EXTENDED_FLAGS_2 else 0
    if extended1 & PUBLISHER_ID_TYPE_BITS > PublisherIdType.STRING:
        raise RemoteWireError(Cause.RESERVED_PUBLISHER_ID_TYPE, f"ExtendedFlags1 0x{extended1:02x}", 1)
    return flags, extended1, extended2


def decode_message_type(extended2: int) -> MessageType:
    """The type of a message, once its reserved flags are seen to be clear."""
    if extended2 & RESERVED_EXTENDED_FLAGS_2:
        raise RemoteWireError(Cause.RESERVED_EXTENDED_FLAGS, f"ExtendedFlags2 0x{extended2:02x}", 2)
    message_type = (extended2 & MESSAGE_TYPE_BITS) >> 2
    if message_type > MessageType.ANNOUNCEMENT:
        raise RemoteWireError(Cause.RESERVED_MESSAGE_TYPE, f"NetworkMessage type {message_type}", 2)
    return MessageType(message_type)


def check_discovery_flags(flags: int, extended1: int, extended2: int) -> None:
    """The flags that 7.2.4.6.3 and 7.2.4.6.12.1 fix; version 1.04 left the security flag open, so we do too."""
    if (
        flags & (HAS_GROUP_HEADER | HAS_PAYLOAD_HEADER)
        or not flags & HAS_PUBLISHER_ID
        or extended1 & (HAS_DATA_SET_CLASS_ID | HAS_TIMESTAMP | HAS_PICOSECONDS)
        or extended2 & (HAS_PROMOTED_FIELDS | HAS_ACTION_HEADER)
    ):
        flag_bytes = f"0x{flags:02x} 0x{extended1:02x} 0x{extended2:02x}"
        raise RemoteWireError(Cause.DISCOVERY_FLAGS, f"flags {flag_bytes} in a discovery message", 0)


def decode_publisher_id(cursor: Cursor, extended1: int) -> tuple[int | str, int]:
    """The PublisherId and its type."""
    publisher_id_type = extended1 & PUBLISHER_ID_TYPE_BITS
    if publisher_id_type == PublisherIdType.STRING:
        return decode_string(cursor) or "", publisher_id_type
    return cursor.unpack(FIXED[PUBLISHER_ID_BUILTIN[publisher_id_type]])[0], publisher_id_type


def decode_group_header(cursor: Cursor) -> tuple[int | None, int | None, int | None, int | None]:
    """WriterGroupId, GroupVersion, NetworkMessageNumber and SequenceNumber, None where they are absent."""
    flags = cursor.byte()
    if flags & RESERVED_GROUP_FLAGS:
        raise RemoteWireError(Cause.RESERVED_GROUP_FLAGS, f"GroupFlags 0x{flags:02x}", cursor.position - 1)
    return (
        cursor.uint16() if flags & HAS_WRITER_GROUP_ID else None,
        cursor.uint32() if flags & HAS_GROUP_VERSION else None,
        cursor.uint16() if flags & HAS_NETWORK_MESSAGE_NUMBER else None,
        cursor.uint16() if flags & HAS_SEQUENCE_NUMBER else None,
    )


def _decode_promoted_fields(
    cursor: Cursor, data_set_writer_ids: tuple[int, ...] | None
) -> tuple[tuple[int, ...], tuple[object, ...]]:
    if data_set_writer_ids is not None and len(data_set_writer_ids) != 1:
        detail = f"promoted fields with {len(data_set_writer_ids)} DataSetMessages"
        raise RemoteWireError(Cause.PROMOTED_COUNT, detail, cursor.position)
    size = cursor.uint16()
    stop = cursor.position + size
    fields: list[Variant] = []
    while cursor.position < stop:
        fields.append(decode_variant(cursor))
    if cursor.position != stop:
        raise RemoteWireError(Cause.PROMOTED_SIZE, f"the size {size} ends inside a field", stop)
    return tuple([field.type for field in fields]), tuple([field.value for field in fields])


def _pass_security_header(cursor: Cursor) -> None:
    """Pass over the security header of a discovery message that says None; refuse one that has keys."""
    flags = cursor.byte()
    if flags:
        raise SecuredMessage(f"a discovery message with SecurityFlags 0x{flags:02x}", cursor.position - 1)
    cursor.take(4)  # SecurityTokenId
    cursor.take(cursor.byte())  # MessageNonce


def encode_publisher_id(out: bytearray, publisher_id: object, publisher_id_type: int) -> None:
    """Append a PublisherId of this type."""
    if publisher_id_type == PublisherIdType.STRING:
        if publisher_id is None:
            raise LocalWireError("a String PublisherId must not be null")
        encode_string(out, publisher_id)
        return
    encode_number(out, PUBLISHER_ID_BUILTIN[publisher_id_type], publisher_id)


def _check_publisher_id_type(publisher_id_type: int) -> None:
    if not 0 <= publisher_id_type <= PublisherIdType.STRING:
        raise LocalWireError(f"{publisher_id_type} is no type of a PublisherId")


def encode_header(out: bytearray, message: NetworkMessage, *, has_action_header: bool = False) -> None:
    """Append everything up to the payload, or up to the ActionHeader where there is one."""
    flags = UADP_VERSION
    extended1 = extended2 = 0
    if message.publisher_id is not None:
        _check_publisher_id_type(message.publisher_id_type)
        flags |= HAS_PUBLISHER_ID
        extended1 |= message.publisher_id_type
    group_flags = (
        (HAS_WRITER_GROUP_ID if message.writer_group_id is not None else 0)
        | (HAS_GROUP_VERSION if message.group_version is not None else 0)
        | (HAS_NETWORK_MESSAGE_NUMBER if message.network_message_number is not None else 0)
        | (HAS_SEQUENCE_NUMBER if message.sequence_number is not None else 0)
    )
    flags |= HAS_GROUP_HEADER if group_flags else 0
    flags |= HAS_PAYLOAD_HEADER if message.payload_header else 0
    extended1 |= HAS_DATA_SET_CLASS_ID if message.data_set_class_id is not None else 0
    extended1 |= HAS_TIMESTAMP if message.timestamp is not None else 0
    extended1 |= HAS_PICOSECONDS if message.picoseconds is not None else 0
    extended2 |= HAS_PROMOTED_FIELDS if message.promoted_types is not None else 0
    extended2 |= HAS_ACTION_HEADER if has_action_header else 0
    extended1 |= HAS_EXTENDED_FLAGS_2 if extended2 else 0
    flags |= HAS_EXTENDED_FLAGS_1 if extended1 else 0
    out.append(flags)
    if extended1:
        out.append(extended1)
    if extended2:
        out.append(extended2)
    if message.publisher_id is not None:
        encode_publisher_id(out, message.publisher_id, message.publisher_id_type)
    if message.data_set_class_id is not None:
        encode_guid(out, message.data_set_class_id)
    if group_flags:
        out.append(group_flags)
        _encode_present(out, BuiltinType.UINT16, message.writer_group_id)
        _encode_present(out, BuiltinType.UINT32, message.group_version)
        _encode_present(out, BuiltinType.UINT16, message.network_message_number)
        _encode_present(out, BuiltinType.UINT16, message.sequence_number)
    if message.payload_header:
        _encode_payload_header(out, message)
    _encode_present(out, BuiltinType.DATETIME, message.timestamp)
    _encode_present(out, BuiltinType.UINT16, message.picoseconds)
    if message.promoted_types is not None:
        _encode_promoted_fields(out, message)


def _encode_present(out: bytearray, kind: BuiltinType, value: int | None) -> None:
    if value is not None:
        encode_number(out, kind, value)


def _encode_payload_header(out: bytearray, message: NetworkMessage) -> None:
    writer_ids = [part.data_set_writer_id for part in message.messages]
    if not 1 <= len(writer_ids) <= 0xFF:
        raise LocalWireError(f"a NetworkMessage holds 1 to 255 DataSetMessages, not {len(writer_ids)}")
    out.append(len(writer_ids))
    try:
        out += struct.pack(f"<{len(writer_ids)}H", *writer_ids)
    except struct.error:
        raise LocalWireError(f"a DataSetWriterId is 0..65535: {writer_ids}") from None


def _encode_promoted_fields(out: bytearray, message: NetworkMessage) -> None:
    types, values = message.promoted_types or (), message.promoted_values or ()
    if len(types) != len(values):
        raise LocalWireError(f"{len(types)} types for {len(values)} promoted fields")
    if len(message.messages) != 1:
        raise LocalWireError("promoted fields go with exactly one DataSetMessage")
    fields = bytearray()
    for code, value in zip(types, values, strict=True):
        encode_typed(fields, code, value)
    encode_number(out, BuiltinType.UINT16, len(fields))
    out += fields


def encode_discovery_header(
    out: bytearray, message_type: MessageType, publisher_id: int | str | None, publisher_id_type: int
) -> None:
    """Append the header of a discovery message, with a security header that says None."""
    _check_publisher_id_type(publisher_id_type)
    out.append(UADP_VERSION | HAS_PUBLISHER_ID | HAS_EXTENDED_FLAGS_1)
    out.append(publisher_id_type | HAS_SECURITY_HEADER | HAS_EXTENDED_FLAGS_2)
    out.append(message_type << 2)
    encode_publisher_id(out, publisher_id, publisher_id_type)
    out += NO_SECURITY
