"""The generic codec: reads and writes any message that we understand, without knowing it beforehand."""

from __future__ import annotations

from struct import Struct

from ua_fleet.errors import LocalWireError
from ua_fleet.values import BuiltinType
from ua_fleet.wire.actions import ActionMessage, decode_action
from ua_fleet.wire.builtin import MISFITS, encode_number
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.data_set_message import decode_data_set_message, encode_data_set_message
from ua_fleet.wire.discovered import AnyAnnouncement
from ua_fleet.wire.discovery import decode_announcement, decode_probe
from ua_fleet.wire.header import Header, MessageType, decode_header, encode_header
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage, Probe

__all__ = ["Decoded", "decode_message", "encode_message"]

Decoded = NetworkMessage | Probe | AnyAnnouncement | ActionMessage


def decode_message(datagram: bytes) -> Decoded:
    """Decode one plain and whole UADP NetworkMessage. Whatever the bytes are, only RemoteWireError comes out.

    A secured message is opened with its key before (`security.py`), a chunk put together with the others (`chunks.py`):
    here the one is a SecuredMessage, the other has Cause.CHUNK.
    """
    cursor = Cursor(datagram)
    header = decode_header(cursor)
    if header.message_type is MessageType.PROBE:
        return decode_probe(cursor, header)
    if header.message_type is MessageType.ANNOUNCEMENT:
        return decode_announcement(cursor, header)
    if header.has_action_header:
        return decode_action(cursor, header)
    return NetworkMessage(
        header.publisher_id,
        header.publisher_id_type,
        header.data_set_class_id,
        header.writer_group_id,
        header.group_version,
        header.network_message_number,
        header.sequence_number,
        header.timestamp,
        header.picoseconds,
        header.promoted_types,
        header.promoted_values,
        header.data_set_writer_ids is not None,
        _decode_payload(cursor, header),
    )


def _decode_payload(cursor: Cursor, header: Header) -> tuple[DataSetMessage, ...]:
    """The DataSetMessages. Without a payload header we take it that there is one, of an unknown DataSetWriter."""
    writer_ids = header.data_set_writer_ids or (0,)
    if len(writer_ids) == 1:
        return (decode_data_set_message(cursor, writer_ids[0]),)
    sizes: tuple[int, ...] = cursor.unpack(Struct(f"<{len(writer_ids)}H"))
    messages: list[DataSetMessage] = []
    for writer_id, size in zip(writer_ids, sizes, strict=True):
        start = cursor.position
        cursor.take(size)
        messages.append(decode_data_set_message(Cursor(cursor.data, start, start + size), writer_id))
    cursor.expect_padding()
    return tuple(messages)


def encode_message(message: NetworkMessage) -> bytes:
    """Encode one NetworkMessage; raises LocalWireError for what cannot be encoded."""
    try:
        return _encode_message(message)
    except MISFITS as error:
        raise LocalWireError(f"a NetworkMessage that is not put together right: {error}") from error


def _encode_message(message: NetworkMessage) -> bytes:
    out = bytearray()
    encode_header(out, message)
    if len(message.messages) == 1:
        encode_data_set_message(out, message.messages[0])
        return bytes(out)
    if not message.payload_header:
        raise LocalWireError("without a payload header a NetworkMessage carries exactly one DataSetMessage")
    payload = bytearray()
    for part in message.messages:
        start = len(payload)
        encode_data_set_message(payload, part)
        encode_number(out, BuiltinType.UINT16, len(payload) - start)
    return bytes(out + payload)
