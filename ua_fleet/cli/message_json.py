"""Decoded messages as JSON; docs/pubsub.md describes the form."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from ua_fleet.cli.discovery_json import announcement_as_json, probe_as_json
from ua_fleet.cli.value_json import data_value_as_json, status_text, time_text, value_as_json
from ua_fleet.dissect.spans import type_name
from ua_fleet.values import BuiltinType, DataValue, Variant
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.generic import Decoded
from ua_fleet.wire.messages import DataSetMessage, FieldEncoding, FrameKind, NetworkMessage, Probe
from ua_fleet.wire.security import SecurityMode

if TYPE_CHECKING:
    from ua_fleet.cli.inspection import Inspected

__all__ = ["MODES", "decoded_as_json", "inspected_as_json"]

MODES: Final = {
    SecurityMode.NONE: "None",
    SecurityMode.SIGN: "Sign",
    SecurityMode.SIGN_AND_ENCRYPT: "SignAndEncrypt",
}
"""The names of MessageSecurityMode (OPC 10000-4 7.20)."""

KINDS: Final = {
    FrameKind.KEY: "key",
    FrameKind.DELTA: "delta",
    FrameKind.EVENT: "event",
    FrameKind.KEEP_ALIVE: "keep-alive",
}


def _fields(message: DataSetMessage) -> Iterator[dict[str, Any]]:
    columns = (
        message.field_source_timestamps,
        message.field_server_timestamps,
        message.field_source_picoseconds,
        message.field_server_picoseconds,
    )
    for position, (code, value) in enumerate(zip(message.types, message.values, strict=True)):
        index = position if message.indices is None else message.indices[position]
        if message.field_status is None:
            yield {"index": index, "type": type_name(code), "value": value_as_json(code, value)}
        else:
            parts = [None if column is None else column[position] for column in columns]
            data_value = DataValue(Variant(code, value), message.field_status[position], *parts)
            yield {"index": index, **data_value_as_json(data_value)}


def data_set_message_as_json(message: DataSetMessage) -> dict[str, Any]:
    """A DataSetMessage with its header and its fields."""
    shown: dict[str, Any] = {
        "data_set_writer_id": message.data_set_writer_id,
        "kind": KINDS[FrameKind(message.kind)],
        "valid": message.valid,
        "encoding": ("Variant", "RawData", "DataValue")[FieldEncoding(message.encoding)],
        "sequence_number": message.sequence_number,
        "timestamp": time_text(message.timestamp),
        "picoseconds": message.picoseconds,
        "status": None if message.status is None else status_text(message.status),
        "major_version": message.major_version,
        "minor_version": message.minor_version,
        "fields": list(_fields(message)),
    }
    if message.raw is not None:
        shown["raw"] = message.raw.hex()
    return shown


def network_message_as_json(message: NetworkMessage) -> dict[str, Any]:
    """What a data message says, except its security."""
    promoted = zip(message.promoted_types or (), message.promoted_values or (), strict=True)
    parts = {
        "data_set_class_id": None if message.data_set_class_id is None else str(message.data_set_class_id),
        "group_version": message.group_version,
        "network_message_number": message.network_message_number,
        "sequence_number": message.sequence_number,
        "timestamp": time_text(message.timestamp),
        "picoseconds": message.picoseconds,
        "promoted_fields": [
            {"index": index, "type": type_name(code), "value": value_as_json(code, value)}
            for index, (code, value) in enumerate(promoted)
        ]
        or None,
    }
    return {
        **{name: part for name, part in parts.items() if part is not None},
        "messages": [data_set_message_as_json(part) for part in message.messages],
    }


def action_as_json(message: ActionMessage) -> dict[str, Any]:
    """What the Action requests or responses of one NetworkMessage say: their header, then each as a message."""
    correlation = message.correlation_data
    return {
        "action": {
            "requestor_id": message.requestor_id,
            "correlation_data": value_as_json(BuiltinType.BYTE_STRING, correlation),
            "response_address": message.response_address,
            "timeout_hint_ms": message.timeout_hint_ms,
        },
        "messages": [
            {
                "data_set_writer_id": part.data_set_writer_id,
                "kind": "action-request" if part.is_request else "action-response",
                "action_target_id": part.action_target_id,
                "request_id": part.request_id,
                "action_state": ActionState(part.action_state).name.capitalize(),
                "timestamp": time_text(part.timestamp),
                "status": None if part.status is None else status_text(part.status),
                "fields": [
                    {"index": index, "type": type_name(code), "value": value_as_json(code, value)}
                    for index, (code, value) in enumerate(zip(part.types, part.values, strict=True))
                ],
            }
            for part in (message, *message.others)
        ],
    }


def inspected_as_json(inspected: Inspected) -> dict[str, Any]:
    """One message for `pubsub decode --json`."""
    heard, chunk = inspected.security, inspected.chunk
    shown: dict[str, Any] = {
        "publisher_id": None if heard is None else heard.publisher_id,
        "writer_group_id": None if heard is None else heard.writer_group_id,
        "security": {
            "mode": None if heard is None else MODES[heard.mode],
            "token_id": None if heard is None or heard.mode is SecurityMode.NONE else heard.token_id,
            "verified": inspected.verified,
        },
        "messages": [],
    }
    if heard is not None and heard.writer_ids:
        shown["data_set_writer_ids"] = list(heard.writer_ids)
    if chunk is not None:
        shown["chunk"] = {
            "message_sequence_number": chunk.message_sequence_number,
            "offset": chunk.offset,
            "size": len(chunk.data),
            "total_size": chunk.total_size,
            "complete": inspected.whole is not None,
        }
    decoded = inspected.decoded if inspected.whole is None else inspected.whole.decoded
    if decoded is not None:
        shown |= decoded_as_json(decoded)
    if inspected.error is not None:
        shown["error"] = str(inspected.error)
    return shown


def decoded_as_json(decoded: Decoded) -> dict[str, Any]:
    """What a message of any kind says, except its security."""
    if isinstance(decoded, NetworkMessage):
        return network_message_as_json(decoded)
    if isinstance(decoded, Probe):
        return {"probe": probe_as_json(decoded)}
    if isinstance(decoded, ActionMessage):
        return action_as_json(decoded)
    return {"announcement": announcement_as_json(decoded)}
