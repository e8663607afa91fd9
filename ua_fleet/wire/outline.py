"""The outline of a NetworkMessage: what stands before its SecurityHeader, read without looking at its content.

Enough to choose a key and to find where the payload begins, and no more: this is read before anything is verified. The
generic codec decodes the same fields with their values (`header.py`).
"""

from __future__ import annotations

from struct import Struct
from typing import Final, NamedTuple

from ua_fleet.errors import RemoteWireError
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.header import (
    HAS_ACTION_HEADER,
    HAS_DATA_SET_CLASS_ID,
    HAS_EXTENDED_FLAGS_1,
    HAS_EXTENDED_FLAGS_2,
    HAS_GROUP_HEADER,
    HAS_PAYLOAD_HEADER,
    HAS_PICOSECONDS,
    HAS_PROMOTED_FIELDS,
    HAS_PUBLISHER_ID,
    HAS_TIMESTAMP,
    IS_CHUNK,
    MessageType,
    check_discovery_flags,
    decode_flags,
    decode_group_header,
    decode_message_type,
    decode_publisher_id,
)
from ua_fleet.wire.messages import PublisherIdType

__all__ = ["Outline", "encode_flags", "is_action", "is_chunk", "read_outline"]

GUID_BYTES: Final = 16
TIMESTAMP_BYTES: Final = 8
PICOSECONDS_BYTES: Final = 2


class Outline(NamedTuple):
    """The three bytes of flags (0 where they are absent), what names the sender, and where things stand."""

    flags: int
    extended1: int
    extended2: int
    flags_size: int
    """How many bytes of flags there are."""
    message_type: MessageType
    publisher_id: int | str | None
    publisher_id_type: int
    writer_group_id: int | None
    writer_ids: tuple[int, ...]
    """Of the payload header; empty without one."""
    payload_header_offset: int
    """Where the payload header stands, or would stand."""

    @property
    def is_chunk(self) -> bool:
        """Whether it is a part of a message."""
        return bool(self.extended2 & IS_CHUNK)

    @property
    def is_action(self) -> bool:
        """Whether an ActionHeader follows the SecurityHeader."""
        return bool(self.extended2 & HAS_ACTION_HEADER)

    @property
    def is_discovery(self) -> bool:
        """Whether it is a probe or an announcement."""
        return self.message_type is not MessageType.DATA_SET


def is_action(datagram: bytes) -> bool:
    """Whether a datagram says that it is an ActionRequest or ActionResponse, secured or not; 0.1 us."""
    return (
        len(datagram) > 2
        and bool(datagram[0] & HAS_EXTENDED_FLAGS_1)
        and bool(datagram[1] & HAS_EXTENDED_FLAGS_2)
        and bool(datagram[2] & HAS_ACTION_HEADER)
    )


def is_chunk(datagram: bytes) -> bool:
    """Whether a datagram says that it is a part of a message, secured or not."""
    return (
        len(datagram) > 2
        and bool(datagram[0] & HAS_EXTENDED_FLAGS_1)
        and bool(datagram[1] & HAS_EXTENDED_FLAGS_2)
        and bool(datagram[2] & IS_CHUNK)
    )


def read_outline(cursor: Cursor) -> Outline:
    """Read up to where the SecurityHeader stands or would stand; raises RemoteWireError."""
    flags, extended1, extended2 = decode_flags(cursor)
    flags_size = cursor.position
    message_type = decode_message_type(extended2)
    if message_type is not MessageType.DATA_SET:
        check_discovery_flags(flags, extended1, extended2)
    publisher_id: int | str | None = None
    publisher_id_type = PublisherIdType.UINT16.value
    if flags & HAS_PUBLISHER_ID:
        publisher_id, publisher_id_type = decode_publisher_id(cursor, extended1)
    if extended1 & HAS_DATA_SET_CLASS_ID:
        cursor.take(GUID_BYTES)
    writer_group_id = decode_group_header(cursor)[0] if flags & HAS_GROUP_HEADER else None
    payload_header_offset = cursor.position
    writer_ids: tuple[int, ...] = ()
    if flags & HAS_PAYLOAD_HEADER:
        if extended2 & IS_CHUNK:  # table 158: one DataSetWriterId and no count
            writer_ids = (cursor.uint16(),)
        else:
            writer_ids = cursor.unpack(Struct(f"<{cursor.byte()}H"))
            if not writer_ids:
                raise RemoteWireError(Cause.NO_DATA_SET_MESSAGE, "a payload header with count 0", payload_header_offset)
    if extended1 & HAS_TIMESTAMP:
        cursor.take(TIMESTAMP_BYTES)
    if extended1 & HAS_PICOSECONDS:
        cursor.take(PICOSECONDS_BYTES)
    if extended2 & HAS_PROMOTED_FIELDS:
        cursor.take(cursor.uint16())
    return Outline(
        flags,
        extended1,
        extended2,
        flags_size,
        message_type,
        publisher_id,
        publisher_id_type,
        writer_group_id,
        writer_ids,
        payload_header_offset,
    )


def encode_flags(flags: int, extended1: int, extended2: int) -> bytes:
    """UADPFlags and as many of the extended ones as are not 0; the bits that announce them are set accordingly."""
    extended1 = extended1 | HAS_EXTENDED_FLAGS_2 if extended2 else extended1 & ~HAS_EXTENDED_FLAGS_2
    flags = flags | HAS_EXTENDED_FLAGS_1 if extended1 else flags & ~HAS_EXTENDED_FLAGS_1
    if extended2:
        return bytes((flags, extended1, extended2))
    return bytes((flags, extended1)) if extended1 else bytes((flags,))
