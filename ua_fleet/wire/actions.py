"""Action requests and responses as bytes. All that is uncertain about these bytes stands in this file.

    NetworkMessage header with bit 5 of ExtendedFlags2 set | [SecurityHeader] | ActionHeader | payload
    ActionHeader   Byte ActionFlags: b0 request (0: response), b1 ResponseAddress, b2 CorrelationData, b3 RequestorId,
                   b4 TimeoutHint; then those that are there, in this order: String, ByteString, Variant, Double in ms
    payload        [UInt16 Sizes[Count] where Count > 1], DataSetMessages of type 5 (request) or 6 (response), each:
                   DataSetMessage header, UInt16 ActionTargetId, UInt16 RequestId, Byte ActionState, UInt16 FieldCount,
                   fields, zero padding

Certain, read in OPC 10000-14 v1.05.06 (reference.opcfoundation.org):
  * The NetworkMessage type is that of data; ExtendedFlags2 bit 5 says that there is an ActionHeader; the PublisherId of
    requests and responses is the Responder's; the ActionHeader follows the SecurityHeader (7.2.4.4.2, table 154).
  * DataSetFlags2 has the types 0101 ActionRequest and 0110 ActionResponse; 0100 is none (7.2.4.5.4, table 162). So each
    message has a DataSetMessage header, as the tables of the messages call them "DataSetMessage", and its Status is
    that of the response (7.2.5.6.3 has it beside the payload, as mandatory).
  * What follows that header, the ActionStates, and that fields are Variants or RawData (7.2.4.5.9, 7.2.4.5.10, tables
    166 and 167; 6.2.11.2.1, table 81).
  * Several requests may share a NetworkMessage and its ActionHeader; each has its own RequestId (6.2.11.2.2).

Deduced:
  * Bits and order of the ActionHeader: of table 154 only its place could be read. The order is that of the JSON mapping
    (7.2.5.6.1), bits and types are those of UA-.NETStandard, which has a note to check them again. Bits 5 to 7 are
    taken as reserved, so a message with one of them is dropped.
  * The ActionHeader is encrypted. 7.2.4.4.1 says "the payload and the Padding field are encrypted", and all else is
    before the SecurityHeader or in it; UA-.NETStandard encrypts from the ActionFlags on, and so do we: `security.py`
    encrypts whatever follows the SecurityHeader.
  * The Timestamp of a request's DataSetMessage header is when it was issued, not when this copy was sent: ours have
    it, and our responders want it.

Open: whether the UADP RequestorId may be anything but a String (JSON has a String); we take Strings only.
UA-.NETStandard sends the body without a DataSetMessage header, against table 162, and cannot read ours. RawData needs
the ActionMetaData of the responder and is refused with a cause.
"""

from __future__ import annotations

import math
from enum import IntEnum
from struct import Struct
from typing import Any, Final, NamedTuple

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType
from ua_fleet.wire.builtin import (
    MISFITS,
    decode_byte_string,
    decode_string,
    encode_byte_string,
    encode_number,
    encode_string,
)
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.data_set_message import (
    FIRST_ACTION_KIND,
    HAS_FLAGS_2,
    HAS_MAJOR_VERSION,
    HAS_STATUS,
    HAS_TIMESTAMP,
    IS_VALID,
    LAST_ACTION_KIND,
    decode_data_set_head,
    decode_fields,
)
from ua_fleet.wire.header import Header, encode_header
from ua_fleet.wire.messages import DataSetMessage, FieldEncoding, NetworkMessage, PublisherIdType
from ua_fleet.wire.packed_fields import keep_content, pack_fields
from ua_fleet.wire.variant import decode_variant, encode_typed

__all__ = [
    "MOST_CORRELATION_BYTES",
    "MOST_REQUESTOR_BYTES",
    "ActionMessage",
    "ActionState",
    "decode_action",
    "encode_action",
    "pass_action_header",
]

# ActionFlags
IS_REQUEST: Final = 0x01
HAS_RESPONSE_ADDRESS: Final = 0x02
HAS_CORRELATION_DATA: Final = 0x04
HAS_REQUESTOR_ID: Final = 0x08
HAS_TIMEOUT_HINT: Final = 0x10
RESERVED_ACTION_FLAGS: Final = 0xE0

ACTION_REQUEST: Final = FIRST_ACTION_KIND
ACTION_RESPONSE: Final = LAST_ACTION_KIND

MOST_CORRELATION_BYTES: Final = 256
MOST_REQUESTOR_BYTES: Final = 256
"""The specification sets no bound; what is kept for each request has one here."""

_DOUBLE = Struct("<d")
_BODY = Struct("<HHB")
_COUNT_BYTES: Final = 2
"""Of the FieldCount."""


class ActionState(IntEnum):
    """ActionState (OPC 10000-14 table 81): what a request wants the responder's state to be, or what it is."""

    IDLE = 0
    EXECUTING = 1
    DONE = 2


class ActionMessage(NamedTuple):
    """One Action request or response, with the ActionHeader that it shares with `others`."""

    publisher_id: int | str | None
    """The Responder's, in both directions."""
    writer_group_id: int | None
    data_set_writer_id: int
    """The Responder's too; 0 without a payload header."""
    action_target_id: int
    request_id: int
    action_state: int
    is_request: bool
    requestor_id: str | None = None
    correlation_data: bytes | None = None
    response_address: str | None = None
    timeout_hint_ms: float | None = None
    types: tuple[int, ...] = ()
    values: tuple[Any, ...] = ()
    """PackedFields where they were packed before, or have been decoded from bytes."""
    status: int | None = None
    """Of a response: a StatusCode of which the upper 16 bits travel."""
    timestamp: int | None = None
    """Ticks, of the DataSetMessage header; in a request of ours, when it was issued."""
    publisher_id_type: int = PublisherIdType.UINT16
    major_version: int | None = None
    """Of the announcement by which the fields were put in order."""
    others: tuple[ActionMessage, ...] = ()
    """The further requests or responses of the same NetworkMessage, in their order."""


def decode_action(cursor: Cursor, header: Header) -> ActionMessage:
    """Decode what follows the header of an Action; raises RemoteWireError."""
    is_request, response_address, correlation_data, requestor_id, timeout_hint_ms = _decode_action_header(cursor)
    messages: list[ActionMessage] = []
    for part, data_set_writer_id in _parts(cursor, header):
        body = _decode_message(part, data_set_writer_id, is_request)
        if body is None:
            continue
        head, (action_target_id, request_id, action_state) = body
        message = ActionMessage(
            header.publisher_id,
            header.writer_group_id,
            data_set_writer_id,
            action_target_id,
            request_id,
            action_state,
            is_request,
            requestor_id,
            correlation_data,
            response_address,
            timeout_hint_ms,
            head.types,
            head.values,
            head.status,
            head.timestamp,
            header.publisher_id_type,
            head.major_version,
        )
        messages.append(message)
    if not messages:
        raise RemoteWireError(Cause.ACTION_KIND, "no DataSetMessage that is valid", cursor.position)
    first, *others = messages
    return first._replace(others=tuple(others)) if others else first


def pass_action_header(cursor: Cursor) -> None:
    """Move behind an ActionHeader: each chunk of an Action has the whole of it before its part of the payload."""
    _decode_action_header(cursor)


def _decode_action_header(cursor: Cursor) -> tuple[bool, str | None, bytes | None, str | None, float | None]:
    """Whether it is a request, then ResponseAddress, CorrelationData, RequestorId and TimeoutHint."""
    start = cursor.position
    flags = cursor.byte()
    if flags & RESERVED_ACTION_FLAGS:
        raise RemoteWireError(Cause.ACTION_FLAGS, f"ActionFlags 0x{flags:02x}", start)
    return (
        bool(flags & IS_REQUEST),
        decode_string(cursor) if flags & HAS_RESPONSE_ADDRESS else None,
        _decode_correlation_data(cursor) if flags & HAS_CORRELATION_DATA else None,
        _decode_requestor_id(cursor) if flags & HAS_REQUESTOR_ID else None,
        _decode_timeout_hint(cursor) if flags & HAS_TIMEOUT_HINT else None,
    )


def _decode_correlation_data(cursor: Cursor) -> bytes | None:
    start = cursor.position
    data = decode_byte_string(cursor)
    if data is not None and len(data) > MOST_CORRELATION_BYTES:
        raise RemoteWireError(Cause.CORRELATION_DATA, f"{len(data)} bytes, at most {MOST_CORRELATION_BYTES}", start)
    return data


def _decode_requestor_id(cursor: Cursor) -> str | None:
    start = cursor.position
    requestor_id = decode_variant(cursor)
    if requestor_id.type != BuiltinType.STRING:
        raise RemoteWireError(Cause.REQUESTOR_ID, f"a Variant of type {requestor_id.type}, not a String", start)
    if cursor.position - start > MOST_REQUESTOR_BYTES:
        detail = f"{cursor.position - start} bytes, at most {MOST_REQUESTOR_BYTES}"
        raise RemoteWireError(Cause.REQUESTOR_ID, detail, start)
    text: str | None = requestor_id.value
    return text


def _decode_timeout_hint(cursor: Cursor) -> float:
    start = cursor.position
    hint: float = cursor.unpack(_DOUBLE)[0]
    if not math.isfinite(hint) or hint < 0:
        raise RemoteWireError(Cause.TIMEOUT_HINT, f"{hint} ms", start)
    return hint


def _parts(cursor: Cursor, header: Header) -> list[tuple[Cursor, int]]:
    """A cursor for each DataSetMessage (7.2.4.5.3), with its DataSetWriterId."""
    writer_ids = header.data_set_writer_ids or (0,)
    if len(writer_ids) == 1:
        return [(cursor, writer_ids[0])]
    sizes: tuple[int, ...] = cursor.unpack(Struct(f"<{len(writer_ids)}H"))
    parts: list[tuple[Cursor, int]] = []
    for writer_id, size in zip(writer_ids, sizes, strict=True):
        start = cursor.position
        cursor.take(size)
        parts.append((Cursor(cursor.data, start, start + size), writer_id))
    cursor.expect_padding()
    return parts


def _decode_message(
    cursor: Cursor, data_set_writer_id: int, is_request: bool
) -> tuple[DataSetMessage, tuple[int, int, int]] | None:
    """One DataSetMessage: its header with the fields, and what stands between them. None for one that is not valid."""
    start = cursor.position
    head = decode_data_set_head(cursor, data_set_writer_id)
    if not head.valid:
        return None
    if head.kind != (ACTION_REQUEST if is_request else ACTION_RESPONSE):
        expected = "request" if is_request else "response"
        raise RemoteWireError(Cause.ACTION_KIND, f"DataSetMessage type {head.kind} for an Action {expected}", start)
    if head.encoding != FieldEncoding.VARIANT:
        raise RemoteWireError(Cause.ACTION_ENCODING, f"field encoding {head.encoding} in an Action", start)
    body: tuple[int, int, int] = cursor.unpack(_BODY)
    if body[2] > ActionState.DONE:
        raise RemoteWireError(Cause.ACTION_STATE, f"ActionState {body[2]}", cursor.position - 1)
    fields_at = cursor.position + _COUNT_BYTES
    head = decode_fields(cursor, head)
    content = bytes(cursor.data[fields_at : cursor.position])
    cursor.expect_padding()
    return head._replace(values=keep_content(head.types, head.values, content)), body


def encode_action(message: ActionMessage) -> bytes:
    """Encode an Action with its `others`; raises LocalWireError for what cannot be encoded."""
    try:
        return _encode_action(message)
    except MISFITS as error:
        raise LocalWireError(f"an Action that is not put together right: {error}") from error


def _encode_action(message: ActionMessage) -> bytes:
    messages = (message._replace(others=()), *message.others)
    if any(_shared(other) != _shared(message) or other.others for other in message.others):
        raise LocalWireError("Actions of one NetworkMessage have the same header")
    out = bytearray()
    network_message = NetworkMessage(
        message.publisher_id,
        message.publisher_id_type,
        writer_group_id=message.writer_group_id,
        messages=tuple([DataSetMessage(part.data_set_writer_id) for part in messages]),
    )
    encode_header(out, network_message, has_action_header=True)
    _encode_action_header(out, message)
    if len(messages) == 1:
        _encode_message(out, message)
        return bytes(out)
    payload = bytearray()
    for part in messages:
        start = len(payload)
        _encode_message(payload, part)
        encode_number(out, BuiltinType.UINT16, len(payload) - start)
    return bytes(out + payload)


def _shared(message: ActionMessage) -> tuple[object, ...]:
    """What stands once in a NetworkMessage."""
    return (
        message.publisher_id,
        message.publisher_id_type,
        message.writer_group_id,
        message.is_request,
        message.requestor_id,
        message.correlation_data,
        message.response_address,
        message.timeout_hint_ms,
    )


def _encode_action_header(out: bytearray, message: ActionMessage) -> None:
    flags = IS_REQUEST if message.is_request else 0
    parts = bytearray()
    if message.response_address is not None:
        flags |= HAS_RESPONSE_ADDRESS
        encode_string(parts, message.response_address)
    if message.correlation_data is not None:
        if len(message.correlation_data) > MOST_CORRELATION_BYTES:
            raise LocalWireError(f"CorrelationData has at most {MOST_CORRELATION_BYTES} bytes")
        flags |= HAS_CORRELATION_DATA
        encode_byte_string(parts, message.correlation_data)
    if message.requestor_id is not None:
        start = len(parts)
        flags |= HAS_REQUESTOR_ID
        encode_typed(parts, BuiltinType.STRING, message.requestor_id)
        if len(parts) - start > MOST_REQUESTOR_BYTES:
            raise LocalWireError(f"a RequestorId has at most {MOST_REQUESTOR_BYTES} bytes")
    if message.timeout_hint_ms is not None:
        if not math.isfinite(message.timeout_hint_ms) or message.timeout_hint_ms < 0:
            raise LocalWireError(f"a TimeoutHint is a duration in ms: {message.timeout_hint_ms}")
        flags |= HAS_TIMEOUT_HINT
        parts += _DOUBLE.pack(message.timeout_hint_ms)
    out.append(flags)
    out += parts


def _encode_message(out: bytearray, message: ActionMessage) -> None:
    if not 0 <= message.action_state <= ActionState.DONE:
        raise LocalWireError(f"{message.action_state} is no ActionState")
    if len(message.types) != len(message.values):
        raise LocalWireError(f"{len(message.types)} types for {len(message.values)} values")
    flags = IS_VALID | HAS_FLAGS_2
    flags |= HAS_STATUS if message.status is not None else 0
    flags |= HAS_MAJOR_VERSION if message.major_version is not None else 0
    out.append(flags)
    kind = ACTION_REQUEST if message.is_request else ACTION_RESPONSE
    out.append(kind | (HAS_TIMESTAMP if message.timestamp is not None else 0))
    if message.timestamp is not None:
        encode_number(out, BuiltinType.DATETIME, message.timestamp)
    if message.status is not None:
        encode_number(out, BuiltinType.UINT16, message.status >> 16)
    if message.major_version is not None:
        encode_number(out, BuiltinType.UINT32, message.major_version)
    out += _BODY.pack(message.action_target_id, message.request_id, message.action_state)
    encode_number(out, BuiltinType.UINT16, len(message.types))
    out += pack_fields(message.types, message.values).content
