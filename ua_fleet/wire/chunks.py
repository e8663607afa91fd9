"""Chunks: the payload of one large message in several NetworkMessages (OPC 10000-14 7.2.4.4.4).

    for datagram in split(plain, most_bytes, message_sequence_number): ...      # [plain] where it fits as it is
    chunk = read_chunk(plain)                                                   # None where it is none
    plain = join(chunk, *parts)                                                 # with the data of all its chunks

Each chunk is a NetworkMessage with all headers of the whole one, the ActionHeader too, so each is secured alone:
`split` before `protect`, `read_chunk` after `unprotect`. In its payload header stands the one DataSetWriterId without a
count; discovery messages have no payload header. Which chunks belong together, in which order they come, and for how
long they are kept, is for `ua_fleet.pubsub.security`.
"""

from __future__ import annotations

from collections.abc import Iterator
from struct import Struct
from typing import Final, NamedTuple

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.wire.actions import pass_action_header
from ua_fleet.wire.causes import Cause, SecuredMessage
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.data_set_message import HAS_FLAGS_2, HAS_SEQUENCE_NUMBER
from ua_fleet.wire.header import (
    HAS_EXTENDED_FLAGS_1,
    HAS_EXTENDED_FLAGS_2,
    HAS_PAYLOAD_HEADER,
    HAS_SECURITY_HEADER,
    IS_CHUNK,
    NO_SECURITY,
    MessageType,
)
from ua_fleet.wire.outline import Outline, encode_flags, read_outline

__all__ = ["CHUNK_FIELDS_BYTES", "Chunk", "ChunkReader", "join", "read_chunk", "split", "split_one_by_one"]

_CHUNK_FIELDS: Final = Struct("<HIIi")
CHUNK_FIELDS_BYTES: Final = _CHUNK_FIELDS.size
"""MessageSequenceNumber, ChunkOffset, TotalSize, and the length of ChunkData, which is a ByteString (table 159)."""
_WRITER_ID: Final = Struct("<H")
_ONE_WRITER: Final = Struct("<BH")
MOST_PAYLOAD_BYTES: Final = 0xFFFF_FFFF


class Chunk(NamedTuple):
    """One chunk, with what tells which message it is a part of."""

    publisher_id: int | str | None
    publisher_id_type: int
    writer_group_id: int | None
    data_set_writer_id: int | None
    """None without a payload header, as in discovery messages."""
    is_action: bool
    is_discovery: bool
    head: bytes
    """The bytes of the whole message up to its payload."""
    message_sequence_number: int
    offset: int
    total_size: int
    data: bytes | memoryview
    """A view of the datagram: what is large is copied once, when all of it is there."""
    action_header: bytes = b""
    """Of an Action: two requestors send with the PublisherId of the same responder, and only this tells them apart."""


def read_chunk(datagram: bytes) -> Chunk | None:
    """The chunk that a plain message is; None if it is none. Raises RemoteWireError for one that cannot be."""
    if not _says_chunk(datagram):
        return None
    cursor = Cursor(datagram)
    outline = read_outline(cursor)
    head, action_header = _head(datagram, cursor, outline)
    at = cursor.position
    number, offset, total_size, length = cursor.unpack(_CHUNK_FIELDS)
    data = memoryview(datagram)[cursor.position :]
    if length < 1:
        raise RemoteWireError(Cause.CHUNK_EMPTY, f"no data at offset {offset} of {total_size}", at)
    if length != len(data):
        cause = Cause.TRUNCATED if len(data) < length else Cause.TRAILING_BYTES
        raise RemoteWireError(cause, f"ChunkData of {length} bytes, and {len(data)} stand there", at)
    if offset + len(data) > total_size:
        detail = f"{len(data)} bytes at offset {offset} of {total_size}"
        raise RemoteWireError(Cause.CHUNK_RANGE, detail, at)
    return Chunk(
        outline.publisher_id,
        outline.publisher_id_type,
        outline.writer_group_id,
        outline.writer_ids[0] if outline.writer_ids else None,
        outline.is_action,
        outline.is_discovery,
        head,
        number,
        offset,
        total_size,
        data,
        action_header,
    )


class ChunkReader:
    """`read_chunk` for one who reads many of them: what stands before the data is the same for most chunks in a row.

    Reading the headers of a chunk anew costs 8 us, and a point cloud has thirty of them.
    """

    __slots__ = ("_last", "_prefix")

    def __init__(self) -> None:
        self._prefix = b""
        """All bytes of the last chunk before its chunk fields. The same bytes mean the same headers."""
        self._last: Chunk | None = None

    def read(self, datagram: bytes) -> Chunk | None:
        """See `read_chunk`."""
        at, last = len(self._prefix), self._last
        if last is None or len(datagram) <= at + CHUNK_FIELDS_BYTES or not datagram.startswith(self._prefix):
            return self._read_anew(datagram)
        number, offset, total_size, length = _CHUNK_FIELDS.unpack_from(datagram, at)
        data = memoryview(datagram)[at + CHUNK_FIELDS_BYTES :]
        if length != len(data) or offset + length > total_size:
            return read_chunk(datagram)  # it says what is wrong
        return last._replace(message_sequence_number=number, offset=offset, total_size=total_size, data=data)

    def _read_anew(self, datagram: bytes) -> Chunk | None:
        chunk = read_chunk(datagram)
        if chunk is not None:
            self._prefix = datagram[: len(datagram) - len(chunk.data) - CHUNK_FIELDS_BYTES]
            self._last = chunk._replace(data=b"")
        return chunk


def _says_chunk(datagram: bytes) -> bool:
    return (
        len(datagram) > 2
        and bool(datagram[0] & HAS_EXTENDED_FLAGS_1)
        and bool(datagram[1] & HAS_EXTENDED_FLAGS_2)
        and bool(datagram[2] & IS_CHUNK)
    )


def _head(datagram: bytes, cursor: Cursor, outline: Outline) -> tuple[bytes, bytes]:
    """Move to the payload, and give the head of the whole message, or of a chunk if this is the whole one.

    The ActionHeader at its end is given once more alone. It is no part of the payload, so each chunk has it (table
    154).
    """
    if outline.extended1 & HAS_SECURITY_HEADER:
        at = cursor.position
        if not outline.is_discovery or cursor.take(len(NO_SECURITY)) != NO_SECURITY:
            raise SecuredMessage("a message that was not opened", at)
    action_header = b""
    if outline.is_action:
        at = cursor.position
        pass_action_header(cursor)
        action_header = datagram[at : cursor.position]
    writer = b""
    behind = outline.payload_header_offset
    if outline.flags & HAS_PAYLOAD_HEADER:
        (writer_id,) = outline.writer_ids
        writer = _ONE_WRITER.pack(1, writer_id) if outline.is_chunk else _WRITER_ID.pack(writer_id)
        behind += 2 if outline.is_chunk else 3
    head = b"".join(
        (
            encode_flags(outline.flags, outline.extended1, outline.extended2 ^ IS_CHUNK),
            datagram[outline.flags_size : outline.payload_header_offset],
            writer,
            datagram[behind : cursor.position],
        )
    )
    return head, action_header


def _number_of(payload: memoryview, outline: Outline) -> int | None:
    """The number that a DataSetMessage or an announcement has in its own header; None without one."""
    if outline.message_type is MessageType.PROBE:
        return None
    if outline.message_type is MessageType.ANNOUNCEMENT:
        at = 1  # behind the AnnouncementType
    elif payload[0] & HAS_SEQUENCE_NUMBER:
        at = 2 if payload[0] & HAS_FLAGS_2 else 1
    else:
        return None
    return int.from_bytes(payload[at : at + 2], "little")


def split(datagram: bytes, most_bytes: int, message_sequence_number: int) -> list[bytes]:
    """The chunks of a plain message, none longer than `most_bytes` and all but the last equally long.

    A message that fits is given back as it is. The chunks have the sequence number of the DataSetMessage or
    announcement that they are made of; where it has none, `message_sequence_number`, which has to be another for each
    message. A NetworkMessage with several DataSetMessages is never split, since a chunk belongs to one of them: send
    each in one of its own. Raises LocalWireError for it and for whatever else cannot be split.
    """
    return list(split_one_by_one(datagram, most_bytes, message_sequence_number))


def split_one_by_one(datagram: bytes, most_bytes: int, message_sequence_number: int) -> Iterator[bytes]:
    """What `split` gives, each chunk made when it is asked for; what cannot be split is told with the first one."""
    if len(datagram) <= most_bytes:
        yield datagram
        return
    cursor = Cursor(datagram)
    try:
        outline = read_outline(cursor)
        if outline.is_chunk:
            raise LocalWireError("a chunk is not split again")
        if len(outline.writer_ids) > 1:
            count = len(outline.writer_ids)
            raise LocalWireError(f"{len(datagram)} bytes with {count} DataSetMessages: send each in its own message")
        head, _ = _head(datagram, cursor, outline)
    except RemoteWireError as error:
        raise LocalWireError(f"a message that cannot be split: {error}") from error
    payload = memoryview(datagram)[cursor.position :]
    size = most_bytes - len(head) - CHUNK_FIELDS_BYTES
    if size < 1:
        raise LocalWireError(f"{most_bytes} bytes have no room for a chunk behind {len(head)} bytes of headers")
    if len(payload) > MOST_PAYLOAD_BYTES:
        raise LocalWireError(f"a payload of {len(payload)} bytes; chunks carry at most {MOST_PAYLOAD_BYTES}")
    number = _number_of(payload, outline)
    if number is None:
        number = message_sequence_number & 0xFFFF
    for offset in range(0, len(payload), size):
        data = payload[offset : offset + size]
        yield b"".join((head, _CHUNK_FIELDS.pack(number, offset, len(payload), len(data)), data))


def join(chunk: Chunk, *parts: bytes | memoryview) -> bytes:
    """The whole plain message of which `chunk` is a part, with the headers of that chunk; `parts` are in order."""
    if (size := sum(map(len, parts))) != chunk.total_size:
        raise LocalWireError(f"a payload of {size} bytes for chunks of {chunk.total_size}")
    return b"".join((chunk.head, *parts))
