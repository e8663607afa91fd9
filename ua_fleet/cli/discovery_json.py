"""Probes and announcements as JSON: their own field names, and values as in `value_json`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, cast

from ua_fleet.cli.value_json import status_text, time_text, value_as_json
from ua_fleet.dissect.annotate_payload import INFORMATION_TYPES
from ua_fleet.dissect.spans import type_name
from ua_fleet.values import (
    BuiltinType,
    ExtensionObject,
    LocalizedText,
    NodeId,
    QualifiedName,
    Variant,
)
from ua_fleet.wire.announcements import ANNOUNCEMENT_NAMES, APPLICATION, HEAD, TYPES
from ua_fleet.wire.discovered import AnyAnnouncement
from ua_fleet.wire.messages import DataSetMetaData, Probe, ProbeKind

__all__ = ["announcement_as_json", "metadata_as_json", "probe_as_json"]

TIMES: Final = ("next_report_time", "timestamp")
STATUSES: Final = ("status", "statuses")
TYPE_OF: Final[tuple[tuple[type, BuiltinType], ...]] = (
    (bytes, BuiltinType.BYTE_STRING),
    (NodeId, BuiltinType.NODE_ID),
    (QualifiedName, BuiltinType.QUALIFIED_NAME),
    (LocalizedText, BuiltinType.LOCALIZED_TEXT),
    (ExtensionObject, BuiltinType.EXTENSION_OBJECT),
    (Variant, BuiltinType.VARIANT),
)


def probe_as_json(probe: Probe) -> dict[str, Any]:
    """What a probe asks for."""
    if probe.kind == ProbeKind.FIND_APPLICATIONS:
        return {"probe_type": 2, "asks_for": "applications"}
    return {
        "probe_type": 1,
        "information_type": probe.kind,
        "asks_for": INFORMATION_TYPES[probe.kind],
        "data_set_writer_ids": list(probe.data_set_writer_ids),
        "writer_group_id": probe.writer_group_id,
        "transport_profile_uris": list(probe.transport_profile_uris),
        "include_writer_groups": probe.include_writer_groups,
        "include_data_set_writers": probe.include_data_set_writers,
    }


def announcement_as_json(announcement: AnyAnnouncement) -> dict[str, Any]:
    """What an announcement tells."""
    kind = TYPES.get(type(announcement), APPLICATION)
    names = announcement._fields[HEAD:]
    body = {
        name: _plain(name, getattr(announcement, name)) for name in names if name not in ("kind", "sequence_number")
    }
    return {
        "announcement_type": kind,
        "tells": ANNOUNCEMENT_NAMES[kind],
        "sequence_number": announcement.sequence_number,
        **body,
    }


def _plain(name: str, value: Any) -> Any:
    for of, kind in TYPE_OF:
        if isinstance(value, of):
            return value_as_json(kind, value)
    if isinstance(value, DataSetMetaData):
        return metadata_as_json(value)
    if hasattr(value, "_fields"):
        return {part: _plain(part, getattr(value, part)) for part in value._fields}
    if isinstance(value, tuple):
        return [_plain(name, element) for element in cast("Sequence[Any]", value)]
    if isinstance(value, int) and name in TIMES:
        return time_text(value)
    if isinstance(value, int) and name in STATUSES:
        return status_text(value)
    return value_as_json(BuiltinType.DOUBLE, value) if isinstance(value, float) else value


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
