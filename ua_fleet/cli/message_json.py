"""Decoded messages as JSON; docs/pubsub.md describes the form.

Numbers, Booleans and Strings are JSON's own. Infinity and NaN are Strings, a DateTime is ISO 8601 in UTC, a ByteString
is base64, a StatusCode its name (or 0x and eight digits), a NodeId its text form. Arrays are lists, matrices lists of
lists.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

from ua_fleet.values import (
    ARRAY,
    DIMENSIONS,
    BuiltinType,
    DataValue,
    ExpandedNodeId,
    ExtensionObject,
    LocalizedText,
    Matrix,
    NodeId,
    QualifiedName,
    StatusCode,
    Variant,
    datetime_from_ticks,
    status_name,
)
from ua_fleet.wire.annotate_payload import ANNOUNCEMENT_TYPES, INFORMATION_TYPES
from ua_fleet.wire.discovery import META_DATA
from ua_fleet.wire.generic import Decoded
from ua_fleet.wire.messages import (
    DataSetMessage,
    DataSetMetaData,
    FieldEncoding,
    FrameKind,
    MetaDataAnnouncement,
    NetworkMessage,
    Probe,
    ProbeKind,
)
from ua_fleet.wire.security import SecurityMode
from ua_fleet.wire.spans import type_name, value_text

if TYPE_CHECKING:
    from ua_fleet.cli.inspection import Inspected

__all__ = ["decoded_as_json", "inspected_as_json", "time_text", "value_as_json"]

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
TICKS_IN_A_MICROSECOND: Final = 10


def time_text(ticks: int | None) -> str | None:
    """A DateTime as ISO 8601 in UTC, to the 100 ns that it has."""
    if ticks is None:
        return None
    text = datetime_from_ticks(ticks).isoformat(timespec="microseconds").removesuffix("+00:00")
    return f"{text}{ticks % TICKS_IN_A_MICROSECOND}".rstrip("0").rstrip(".") + "Z"


def status_text(status: int) -> str:
    """A StatusCode by its name where that says all of it."""
    return status_name(status) if status in list(StatusCode) else f"0x{status:08X}"


def value_as_json(code: int, value: Any) -> Any:
    """A value of a type code as JSON can hold it."""
    if code & DIMENSIONS:
        matrix: Matrix = value
        flat = [value_as_json(code & ~(ARRAY | DIMENSIONS), element) for element in matrix.values]
        return _nested(flat, matrix.dimensions) if flat else []  # dimensions of nothing may be as large as they like
    if code & ARRAY:
        return None if value is None else [value_as_json(code & ~(ARRAY | DIMENSIONS), element) for element in value]
    if code == BuiltinType.DATETIME:
        return time_text(value)
    if code == BuiltinType.STATUS_CODE:
        return status_text(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value).replace("inf", "Infinity").replace("nan", "NaN")
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    return _structure_as_json(code, value)


def _nested(flat: list[Any], dimensions: Sequence[int]) -> list[Any]:
    if len(dimensions) < 2:
        return flat
    size = len(flat) // dimensions[0]
    return [_nested(flat[start * size : (start + 1) * size], dimensions[1:]) for start in range(dimensions[0])]


def _structure_as_json(code: int, value: Any) -> Any:
    if isinstance(value, Variant):
        return {"type": type_name(value.type), "value": value_as_json(*value)}
    if isinstance(value, DataValue):
        return data_value_as_json(value)
    if isinstance(value, LocalizedText):
        return {"locale": value.locale, "text": value.text}
    if isinstance(value, ExtensionObject):
        return {
            "type_id": value_text(BuiltinType.NODE_ID, value.type_id),
            "body": value_as_json(BuiltinType.BYTE_STRING, value.body),
        }
    if isinstance(value, NodeId | ExpandedNodeId | QualifiedName):
        return value_text(code, value)
    if hasattr(value, "_asdict"):
        return {name: value_as_json(BuiltinType.DIAGNOSTIC_INFO, part) for name, part in value._asdict().items()}
    return str(value)  # a Guid


def data_value_as_json(value: DataValue) -> dict[str, Any]:
    """A DataValue: its value with type, and what else it has."""
    variant = value.variant or Variant(BuiltinType.NULL, None)
    parts = {
        "source_timestamp": time_text(value.source_timestamp),
        "server_timestamp": time_text(value.server_timestamp),
        "source_picoseconds": value.source_picoseconds,
        "server_picoseconds": value.server_picoseconds,
    }
    return {
        "type": type_name(variant.type),
        "value": value_as_json(*variant),
        "status": status_text(value.status),
        **{name: part for name, part in parts.items() if part is not None},
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
        return {
            "probe": {
                "information_type": decoded.kind,
                "asks_for": INFORMATION_TYPES[ProbeKind(decoded.kind)],
                "data_set_writer_ids": list(decoded.data_set_writer_ids),
            }
        }
    if isinstance(decoded, MetaDataAnnouncement):
        announced = {
            "data_set_writer_id": decoded.data_set_writer_id,
            "status": status_text(decoded.status),
            "metadata": metadata_as_json(decoded.metadata),
        }
        kind = META_DATA
    else:
        announced, kind = {"body": decoded.body.hex()}, decoded.kind
    return {
        "announcement": {
            "announcement_type": kind,
            "tells": ANNOUNCEMENT_TYPES[kind],
            "sequence_number": decoded.sequence_number,
            **announced,
        }
    }


def metadata_as_json(metadata: DataSetMetaData) -> dict[str, Any]:
    """A DataSetMetaData."""
    return {
        "name": metadata.name,
        "major_version": metadata.configuration_version.major,
        "minor_version": metadata.configuration_version.minor,
        "fields": [
            {
                "index": index,
                "name": field.name,
                "type": type_name(field.builtin_type),
                "value_rank": field.value_rank,
                "properties": {str(key.name): value_as_json(code, value) for key, code, value in field.properties},
            }
            for index, field in enumerate(metadata.fields)
        ],
    }
