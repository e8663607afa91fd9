"""Action requests and responses as JSON (OPC 10000-14 7.2.5.6).

    NetworkMessage  MessageId, MessageType `ua-action-request` or `ua-action-response`, PublisherId (of the Responder),
                    Timestamp, ResponseAddress (requests), CorrelationData, RequestorId, TimeoutHint (requests),
                    Messages
    each message    DataSetWriterId, ActionTargetId, DataSetWriterName, WriterGroupName, MetaDataVersion or
                    MinorVersion, Timestamp, Status (responses), MessageType, RequestId, ActionState, Payload

Table 195 calls the list `Message`, the DataType JsonActionNetworkMessage calls it `Messages`; we write the one and read
both. The payload is an object of fields by name, so it needs the ActionMetaData; without it stays text, in `payloads`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import orjson

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType
from ua_fleet.wire.actions import MOST_CORRELATION_BYTES, MOST_REQUESTOR_BYTES, ActionMessage, ActionState
from ua_fleet.wire.builtin import MISFITS
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.data_sets import DataSetFields, keep_payload
from ua_fleet.wire.json.dates import decode_date, encode_date
from ua_fleet.wire.json.fields import Form
from ua_fleet.wire.json.headers import (
    decode_message_id,
    decode_publisher_id,
    decode_text,
    decode_version,
    decode_writer_id,
    encode_publisher_id,
)
from ua_fleet.wire.json.parsing import Reading, dump, shown
from ua_fleet.wire.json.scalars import SCALAR_ENCODERS, decode_byte_string, decode_integer, decode_status, encode_status
from ua_fleet.wire.json.structures import decode_enumeration
from ua_fleet.wire.messages import DataSetMessage, PublisherIdType

__all__ = ["REQUEST", "RESPONSE", "ActionFieldsOf", "JsonAction", "decode_action", "encode_action"]

REQUEST: Final = "ua-action-request"
RESPONSE: Final = "ua-action-response"

ActionFieldsOf = Callable[[str, int, bool], DataSetFields | None]
"""(PublisherId of the Responder, DataSetWriterId, whether it is a request) -> the fields of the ActionMetaData."""


class JsonAction(NamedTuple):
    """One NetworkMessage of Actions, with what only JSON has."""

    message: ActionMessage
    """The first request or response, with the others of the NetworkMessage in its `others`."""
    message_id: str | None = None
    timestamp: int | None = None
    """Ticks, when it was sent first."""
    payloads: tuple[bytes | None, ...] = ()
    """The text of each payload for which there is no metadata."""
    leniencies: Mapping[Leniency, int] = MappingProxyType({})


def decode_action(reading: Reading, tree: dict[str, Any], fields_of: ActionFieldsOf) -> JsonAction:
    """Actions from their parsed text; raises RemoteWireError."""
    is_request = tree["MessageType"] == REQUEST
    message_id = decode_message_id(reading, tree.get("MessageId"))
    if tree.get("PublisherId") is None:
        raise RemoteWireError(JsonCause.MISSING, "PublisherId is missing")
    head = ActionMessage(
        decode_publisher_id(reading, tree["PublisherId"]),
        None,
        0,
        0,
        0,
        0,
        is_request,
        _decode_requestor(reading, tree.get("RequestorId")),
        _decode_correlation(reading, tree.get("CorrelationData")),
        None if tree.get("ResponseAddress") is None else decode_text(tree["ResponseAddress"], "ResponseAddress"),
        _decode_timeout(tree.get("TimeoutHint"), is_request=is_request),
        publisher_id_type=PublisherIdType.STRING.value,
    )
    time = tree.get("Timestamp")
    timestamp = None if time is None else decode_date(reading, time)
    items = tree.get("Messages")
    if items is None and "Message" in tree:
        reading.note(Leniency.MESSAGE_MEMBER)
        items = tree["Message"]
    if items.__class__ is dict:
        items = [items]
    if items.__class__ is not list or not items:
        raise RemoteWireError(JsonCause.MISSING, "Actions without Messages")
    decoded = [_decode_message(reading, head, item, fields_of) for item in items]
    (first, _), *others = decoded
    message = first._replace(others=tuple([other for other, _ in others]))
    return JsonAction(message, message_id, timestamp, tuple([payload for _, payload in decoded]), reading.leniencies)


def _decode_requestor(reading: Reading, value: Any) -> str | None:
    if value is None:
        return None
    requestor = decode_publisher_id(reading, value)
    if len(requestor.encode()) > MOST_REQUESTOR_BYTES:
        raise RemoteWireError(JsonCause.ACTION, f"a RequestorId of more than {MOST_REQUESTOR_BYTES} bytes")
    return requestor


def _decode_correlation(reading: Reading, value: Any) -> bytes | None:
    data = decode_byte_string(reading, value)
    if data is not None and len(data) > MOST_CORRELATION_BYTES:
        raise RemoteWireError(JsonCause.ACTION, f"CorrelationData of more than {MOST_CORRELATION_BYTES} bytes")
    return data


def _decode_timeout(value: Any, *, is_request: bool) -> float | None:
    """The TimeoutHint of a request; one that is left out is 0, which the CompactEncoding leaves out."""
    if not is_request or value is None:
        return 0.0 if is_request else None
    if value.__class__ not in (int, float) or not math.isfinite(value) or value < 0:
        raise RemoteWireError(JsonCause.ACTION, f"a TimeoutHint that is no duration: {shown(value)}")
    return float(value)


def _decode_message(
    reading: Reading, head: ActionMessage, item: Any, fields_of: ActionFieldsOf
) -> tuple[ActionMessage, bytes | None]:
    if item.__class__ is not dict:
        raise RemoteWireError(JsonCause.SHAPE, f"an Action that is no object: {shown(item)}")
    kind = item.get("MessageType")
    if kind is not None and kind != (REQUEST if head.is_request else RESPONSE):
        raise RemoteWireError(JsonCause.MESSAGE_TYPE, f"an Action of type {shown(kind)} among others")
    writer_id, _ = decode_writer_id(reading, item.get("DataSetWriterId") or 0, None)
    state = decode_enumeration(reading, item.get("ActionState") or 0)
    if not 0 <= state <= ActionState.DONE:
        raise RemoteWireError(JsonCause.ACTION, f"ActionState {state}")
    major, _ = decode_version(reading, item)
    time, status = item.get("Timestamp"), item.get("Status")
    message = head._replace(
        data_set_writer_id=writer_id or 0,
        action_target_id=decode_integer(reading, BuiltinType.UINT16, item.get("ActionTargetId") or 0),
        request_id=decode_integer(reading, BuiltinType.UINT16, item.get("RequestId") or 0),
        action_state=state,
        status=None if head.is_request else 0 if status is None else decode_status(reading, status),
        timestamp=None if time is None else decode_date(reading, time),
        major_version=major,
    )
    payload = item.get("Payload")
    if payload is None or payload == {}:
        return message, None
    part = DataSetMessage(message.data_set_writer_id, major_version=major)
    fields = fields_of(str(head.publisher_id), message.data_set_writer_id, head.is_request)
    if fields is None or not fields.fits(part):
        return message, keep_payload(part, payload).raw
    part = fields.decode(reading, part, payload)
    worst = max(part.field_status or (), key=_severity, default=0)
    status = message.status
    if message.is_request:
        # A robot would act on a value that its sender says is none.
        if _severity(worst):
            raise RemoteWireError(JsonCause.ACTION, f"an argument with the status 0x{worst:08X}")
        if Leniency.NULL_NUMBER in reading.leniencies:
            raise RemoteWireError(JsonCause.ACTION, "an argument with null in place of a number")
    elif _severity(worst) > _severity(status or 0):
        status = worst  # the results of an Action have no status of their own, so that of the Action says it
    return message._replace(types=part.types, values=part.values, status=status), None


def _severity(status: int) -> int:
    """0 of a Good status, 1 of an Uncertain one, 2 and 3 of a Bad one."""
    return status >> 30


def encode_action(action: JsonAction, fields: Sequence[DataSetFields | None], form: Form = Form.VERBOSE) -> bytes:
    """The text of Actions; raises LocalWireError.

    Args:
        action: the message; each of its payloads that is None is made of the message's fields.
        fields: those of the ActionMetaData of each message; None where it has no fields, or a payload as text.
        form: how fields are written; Verbose is recommended (7.2.5.4.2).
    """
    try:
        return _encode_action(action, fields, form)
    except MISFITS as error:
        raise LocalWireError(f"an Action that is not put together right: {error}") from error


def _encode_action(action: JsonAction, fields: Sequence[DataSetFields | None], form: Form) -> bytes:
    first = action.message
    messages = (first._replace(others=()), *first.others)
    if len(fields) != len(messages):
        raise LocalWireError(f"fields of {len(fields)} for {len(messages)} Actions")
    if action.message_id is None or first.publisher_id is None or action.timestamp is None:
        raise LocalWireError("Actions without their MessageId, PublisherId or Timestamp")
    out: dict[str, Any] = {
        "MessageId": action.message_id,
        "MessageType": REQUEST if first.is_request else RESPONSE,
        "PublisherId": encode_publisher_id(first.publisher_id),
        "Timestamp": encode_date(action.timestamp),
    }
    if first.is_request:
        if first.response_address is None:
            raise LocalWireError("a request without its ResponseAddress")
        out["ResponseAddress"] = first.response_address
    if first.correlation_data is not None:
        if len(first.correlation_data) > MOST_CORRELATION_BYTES:
            raise LocalWireError(f"CorrelationData has at most {MOST_CORRELATION_BYTES} bytes")
        out["CorrelationData"] = SCALAR_ENCODERS[BuiltinType.BYTE_STRING]((), False, first.correlation_data)
    if first.requestor_id is not None:
        if len(first.requestor_id.encode()) > MOST_REQUESTOR_BYTES:
            raise LocalWireError(f"a RequestorId has at most {MOST_REQUESTOR_BYTES} bytes")
        out["RequestorId"] = first.requestor_id
    if first.is_request:
        hint = first.timeout_hint_ms or 0.0
        if not math.isfinite(hint) or hint < 0:
            raise LocalWireError(f"a TimeoutHint is a duration in ms: {hint}")
        out["TimeoutHint"] = hint
    payloads = action.payloads or (None,) * len(messages)
    out["Messages"] = [
        _encode_message(first, message, its_fields, payload, form)
        for message, its_fields, payload in zip(messages, fields, payloads, strict=True)
    ]
    return dump(out)


def _encode_message(
    first: ActionMessage, message: ActionMessage, fields: DataSetFields | None, payload: bytes | None, form: Form
) -> dict[str, Any]:
    if message.is_request != first.is_request or not 0 <= message.action_state <= ActionState.DONE:
        raise LocalWireError(
            "Actions of one NetworkMessage are all requests or all responses, with a legal ActionState"
        )
    uint16 = SCALAR_ENCODERS[BuiltinType.UINT16]
    out: dict[str, Any] = {
        "DataSetWriterId": uint16((), False, message.data_set_writer_id),
        "ActionTargetId": uint16((), False, message.action_target_id),
    }
    if message.major_version is not None:
        version = SCALAR_ENCODERS[BuiltinType.UINT32]((), False, message.major_version)
        minor = version if fields is None else fields.metadata.configuration_version.minor
        out["MetaDataVersion"] = {"MajorVersion": version, "MinorVersion": minor}
    if message.timestamp is not None:
        out["Timestamp"] = encode_date(message.timestamp)
    if not message.is_request:
        out["Status"] = encode_status((), False, message.status or 0)
    out["MessageType"] = REQUEST if message.is_request else RESPONSE
    out["RequestId"] = uint16((), False, message.request_id)
    out["ActionState"] = int(message.action_state)
    if payload is not None:
        out["Payload"] = orjson.Fragment(payload)
    elif fields is not None and message.types:
        part = DataSetMessage(message.data_set_writer_id, types=message.types, values=message.values)
        out["Payload"] = fields.encode(fields.writing(form), part)
    elif message.types:
        raise LocalWireError("fields of an Action without their metadata: JSON needs their names")
    else:
        out["Payload"] = {}
    return out
