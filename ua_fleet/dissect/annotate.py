"""Annotates a NetworkMessage: the name, offset and meaning of each of its bytes (OPC 10000-14 7.2.4).

    annotate(datagram)                      a plain message, or what can be read of a secured one
    annotate(datagram, payload=decrypted)   an encrypted one that was opened: the bytes that were encrypted, in plain
    annotate(datagram, is_open=True)        one in which they stand in plain already (`security.opened_form`)
    annotate(datagram, closed=True)         one that does not verify: its payload is not looked into
    annotate(datagram, error=refused)       one that Codec.decode refused: up to there, the rest as it is

The spans cover each byte once and in order. Whether a message is right is the decoder's to say, never this module's:
where the two disagree, a test fails.
"""

from __future__ import annotations

import contextlib
from typing import Final

from ua_fleet.dissect.annotate_payload import walk_action_header, walk_announcement, walk_data_set_messages, walk_probe
from ua_fleet.dissect.spans import ByteSpan, Flag, MessageWalk
from ua_fleet.errors import RemoteWireError
from ua_fleet.values import BuiltinType
from ua_fleet.wire import header as h
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.messages import PublisherIdType
from ua_fleet.wire.security import (
    FORCE_KEY_RESET,
    HAS_SECURITY_FOOTER,
    IS_ENCRYPTED,
    IS_SIGNED,
    NONCE_BYTES,
    RESERVED_SECURITY_FLAGS,
    SIGNATURE_BYTES,
)

__all__ = ["annotate"]

PUBLISHER_ID_TYPES: Final[dict[int, str]] = {
    PublisherIdType.BYTE: "Byte",
    PublisherIdType.UINT16: "UInt16",
    PublisherIdType.UINT32: "UInt32",
    PublisherIdType.UINT64: "UInt64",
    PublisherIdType.STRING: "String",
}
UADP_FLAGS: Final[tuple[Flag, ...]] = (
    (h.HAS_PUBLISHER_ID, "PublisherId"),
    (h.HAS_GROUP_HEADER, "GroupHeader"),
    (h.HAS_PAYLOAD_HEADER, "PayloadHeader"),
    (h.HAS_EXTENDED_FLAGS_1, "ExtendedFlags1"),
)
EXTENDED_FLAGS_1: Final[tuple[Flag, ...]] = (
    (h.HAS_DATA_SET_CLASS_ID, "DataSetClassId"),
    (h.HAS_SECURITY_HEADER, "SecurityHeader"),
    (h.HAS_TIMESTAMP, "Timestamp"),
    (h.HAS_PICOSECONDS, "PicoSeconds"),
    (h.HAS_EXTENDED_FLAGS_2, "ExtendedFlags2"),
)
EXTENDED_FLAGS_2: Final[tuple[Flag, ...]] = (
    (h.IS_CHUNK, "chunk"),
    (h.HAS_PROMOTED_FIELDS, "PromotedFields"),
    (h.HAS_ACTION_HEADER, "ActionHeader"),
    (h.RESERVED_EXTENDED_FLAGS_2, "reserved bits"),
)
GROUP_FLAGS: Final[tuple[Flag, ...]] = (
    (h.HAS_WRITER_GROUP_ID, "WriterGroupId"),
    (h.HAS_GROUP_VERSION, "GroupVersion"),
    (h.HAS_NETWORK_MESSAGE_NUMBER, "NetworkMessageNumber"),
    (h.HAS_SEQUENCE_NUMBER, "SequenceNumber"),
    (h.RESERVED_GROUP_FLAGS, "reserved bits"),
)
SECURITY_FLAGS: Final[tuple[Flag, ...]] = (
    (IS_SIGNED, "signed"),
    (IS_ENCRYPTED, "encrypted"),
    (HAS_SECURITY_FOOTER, "SecurityFooter"),
    (FORCE_KEY_RESET, "force key reset"),
    (RESERVED_SECURITY_FLAGS, "reserved bits"),
)
NETWORK_MESSAGE_TYPES: Final = ("DataSetMessages", "discovery probe", "discovery announcement")


def annotate(
    datagram: bytes,
    *,
    payload: bytes | None = None,
    is_open: bool = False,
    closed: bool = False,
    error: RemoteWireError | None = None,
) -> tuple[ByteSpan, ...]:
    """Name every byte of a NetworkMessage.

    Args:
        datagram: as it was received.
        payload: what was encrypted, decrypted; of an encrypted message without it, only the headers are named.
        is_open: what was encrypted stands in `datagram` decrypted.
        closed: name the headers only.
        error: why the message was refused, with its offset in `datagram`: what stands behind that is not named.
    """
    message = _Message(datagram, payload, is_open, closed)
    with contextlib.suppress(RemoteWireError):  # the decoder says the same; the spans up to there are right
        message.walk()
    return message.covered(len(datagram) if error is None or error.offset < 0 else error.offset)


class _Message:
    """One NetworkMessage, and what its flags say about what follows."""

    def __init__(self, datagram: bytes, payload: bytes | None, is_open: bool, closed: bool) -> None:
        self._datagram, self._payload, self._is_open, self._closed = datagram, payload, is_open, closed
        self._walk = MessageWalk(datagram)
        self._extended1 = self._extended2 = 0
        self._writers = 1
        self._footer_size = 0
        self._end = len(datagram)
        """Where footer and signature begin."""
        self._encrypted = False

    @property
    def _type(self) -> int:
        return (self._extended2 & h.MESSAGE_TYPE_BITS) >> 2

    def walk(self) -> None:
        flags = self._flags()
        walk = self._walk
        if flags & h.HAS_PUBLISHER_ID:
            self._publisher_id()
        if self._extended1 & h.HAS_DATA_SET_CLASS_ID:
            walk.value("DataSetClassId", BuiltinType.GUID)
        if flags & h.HAS_GROUP_HEADER:
            self._group_header()
        if flags & h.HAS_PAYLOAD_HEADER:
            self._payload_header()
        self._extended_header()
        if self._extended1 & h.HAS_SECURITY_HEADER:
            self._security_header()
        self._walk_payload()

    def _flags(self) -> int:
        walk = self._walk
        walk.section = "NetworkMessage header"
        flags = walk.flags("UADPFlags", UADP_FLAGS, lambda value: f"version {value & 0x0F}")
        if flags & h.HAS_EXTENDED_FLAGS_1:
            has_publisher_id = bool(flags & h.HAS_PUBLISHER_ID)
            self._extended1 = walk.flags(
                "ExtendedFlags1",
                EXTENDED_FLAGS_1,
                lambda value: (
                    f"PublisherId is a {PUBLISHER_ID_TYPES.get(value & h.PUBLISHER_ID_TYPE_BITS, 'reserved type')}"
                    if has_publisher_id
                    else ""
                ),
            )
        if self._extended1 & h.HAS_EXTENDED_FLAGS_2:
            self._extended2 = walk.flags("ExtendedFlags2", EXTENDED_FLAGS_2, _message_type_text)
        return flags

    def _publisher_id(self) -> None:
        kind = self._extended1 & h.PUBLISHER_ID_TYPE_BITS
        self._walk.value("PublisherId", h.PUBLISHER_ID_BUILTIN.get(kind, BuiltinType.STRING))

    def _group_header(self) -> None:
        walk = self._walk
        walk.section = "GroupHeader"
        flags = walk.flags("GroupFlags", GROUP_FLAGS)
        for bit, name, kind in (
            (h.HAS_WRITER_GROUP_ID, "WriterGroupId", BuiltinType.UINT16),
            (h.HAS_GROUP_VERSION, "GroupVersion", BuiltinType.UINT32),
            (h.HAS_NETWORK_MESSAGE_NUMBER, "NetworkMessageNumber", BuiltinType.UINT16),
            (h.HAS_SEQUENCE_NUMBER, "SequenceNumber", BuiltinType.UINT16),
        ):
            if flags & bit:
                walk.number(name, kind)

    def _payload_header(self) -> None:
        walk = self._walk
        walk.section = "PayloadHeader"
        if self._extended2 & h.IS_CHUNK:
            walk.number("DataSetWriterId", BuiltinType.UINT16)
            return
        self._writers = walk.read("Count", Cursor.byte, lambda count: f"{count} DataSetMessage{'s' * (count != 1)}")
        for index in range(self._writers):
            walk.number(f"DataSetWriterIds[{index}]", BuiltinType.UINT16)

    def _extended_header(self) -> None:
        walk = self._walk
        walk.section = "ExtendedNetworkMessageHeader"
        if self._extended1 & h.HAS_TIMESTAMP:
            walk.number("Timestamp", BuiltinType.DATETIME)
        if self._extended1 & h.HAS_PICOSECONDS:
            walk.number("PicoSeconds", BuiltinType.UINT16, " x 10 ps")
        if self._extended2 & h.HAS_PROMOTED_FIELDS:
            walk.section = "PromotedFields"
            size = walk.number("Size", BuiltinType.UINT16, " bytes")
            stop, index = walk.cursor.position + size, 0
            while walk.cursor.position < stop:
                walk.variant(f"Fields[{index}]")
                index += 1

    def _security_header(self) -> None:
        walk = self._walk
        walk.section = "SecurityHeader"
        flags = walk.flags("SecurityFlags", SECURITY_FLAGS)
        walk.number("SecurityTokenId", BuiltinType.UINT32)
        size = walk.read("NonceLength", Cursor.byte, lambda count: f"{count} bytes")
        if size == NONCE_BYTES:
            walk.take("MessageNonce.Random", 4)
            walk.number("MessageNonce.SequenceNumber", BuiltinType.UINT32)
        else:
            walk.take("MessageNonce", size)
        if flags & HAS_SECURITY_FOOTER:
            self._footer_size = walk.number("SecurityFooterSize", BuiltinType.UINT16, " bytes")
        self._encrypted = bool(flags & IS_ENCRYPTED)
        self._end -= self._footer_size + (SIGNATURE_BYTES if flags & IS_SIGNED else 0)

    def _walk_payload(self) -> None:
        start, end = self._walk.cursor.position, self._end
        if end < start:
            self._end = len(self._datagram)
            return
        data = self._datagram
        if self._payload is not None:
            data = data[:start] + self._payload + data[end:]
        inner = MessageWalk(data, start, end)
        inner.spans = self._walk.spans
        self._walk = inner
        inner.section = "Payload"
        if self._encrypted and self._payload is None and not self._is_open:
            inner.rest("EncryptedData", f"{end - start} bytes, not to be read without the key")
        elif self._closed:
            inner.rest("NotRead", f"{end - start} bytes of a message that does not verify")
        else:
            self._walk_content(inner)

    def _walk_content(self, inner: MessageWalk) -> None:
        if self._extended2 & h.HAS_ACTION_HEADER:
            walk_action_header(inner)
        if self._extended2 & h.IS_CHUNK:
            _walk_chunk(inner)
        elif self._type == h.MessageType.PROBE:
            walk_probe(inner)
        elif self._type == h.MessageType.ANNOUNCEMENT:
            walk_announcement(inner)
        else:
            walk_data_set_messages(inner, self._writers)

    def covered(self, stop: int) -> tuple[ByteSpan, ...]:
        """The spans that begin before `stop`, and one for whatever was not read, so that no byte is left out."""
        spans = [span for span in self._walk.spans if span.offset < stop]
        read = spans[-1].offset + len(spans[-1].data) if spans else 0
        end = max(self._end, read)
        if read < end:
            data = self._walk.cursor.data[read:end]
            section = spans[-1].section if spans else "NetworkMessage header"
            spans.append(ByteSpan(read, data, section, "NotRead", None, f"{len(data)} bytes"))
        signature = end + self._footer_size
        for start, until, name in (
            (end, signature, "SecurityFooter"),
            (signature, len(self._datagram), "Signature"),
        ):
            if start < min(until, len(self._datagram)):
                data = self._datagram[start:until]
                said = "HMAC-SHA256 over all bytes before it" if name == "Signature" else f"{len(data)} bytes"
                spans.append(ByteSpan(start, data, name, name, None, said))
        return tuple(spans)


def _message_type_text(extended2: int) -> str:
    kind = (extended2 & h.MESSAGE_TYPE_BITS) >> 2
    return NETWORK_MESSAGE_TYPES[kind] if kind < len(NETWORK_MESSAGE_TYPES) else f"reserved type {kind}"


def _walk_chunk(walk: MessageWalk) -> None:
    """A part of a payload (7.2.4.4.4)."""
    walk.section = "ChunkedNetworkMessage"
    walk.number("MessageSequenceNumber", BuiltinType.UINT16)
    offset = walk.number("ChunkOffset", BuiltinType.UINT32)
    total = walk.number("TotalSize", BuiltinType.UINT32, " bytes")
    walk.number("ChunkData.Length", BuiltinType.INT32, " bytes")
    size = walk.cursor.remaining
    walk.rest("ChunkData", f"bytes {offset} to {offset + size - 1} of {total}" if size else "")
