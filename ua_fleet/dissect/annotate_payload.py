"""Annotates what the headers of a NetworkMessage are about: DataSetMessages, probes, announcements, Actions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from ua_fleet.dissect.layouts import walk_fields, walk_shape
from ua_fleet.dissect.spans import Flag, MessageWalk
from ua_fleet.values import BuiltinType, status_name
from ua_fleet.wire import actions as a
from ua_fleet.wire import data_set_message as d
from ua_fleet.wire.announcements import (
    ANNOUNCEMENT_NAMES,
    APPLICATION,
    BODIES,
    CAPABILITIES,
    DESCRIPTION,
    HEAD,
    STATUS,
)
from ua_fleet.wire.configuration import APPLICATION_DESCRIPTION
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.discovery import FIND_APPLICATIONS_PROBE, INFORMATION_PROBE
from ua_fleet.wire.messages import FieldEncoding, FrameKind, ProbeKind
from ua_fleet.wire.structure import BOOLEAN, STRING, UINT16, Shape, array

__all__ = ["walk_action_header", "walk_announcement", "walk_data_set_messages", "walk_probe"]

FIELD_ENCODINGS: Final = ("Variant", "RawData", "DataValue", "reserved field encoding")
KINDS: Final = {
    FrameKind.KEY: "key frame",
    FrameKind.DELTA: "delta frame",
    FrameKind.EVENT: "event",
    FrameKind.KEEP_ALIVE: "keep-alive",
    d.FIRST_ACTION_KIND: "Action request",
    d.LAST_ACTION_KIND: "Action response",
}
FLAGS_1: Final[tuple[Flag, ...]] = (
    (d.HAS_SEQUENCE_NUMBER, "DataSetMessageSequenceNumber"),
    (d.HAS_STATUS, "Status"),
    (d.HAS_MAJOR_VERSION, "ConfigurationVersionMajorVersion"),
    (d.HAS_MINOR_VERSION, "ConfigurationVersionMinorVersion"),
    (d.HAS_FLAGS_2, "DataSetFlags2"),
)
FLAGS_2: Final[tuple[Flag, ...]] = (
    (d.HAS_TIMESTAMP, "Timestamp"),
    (d.HAS_PICOSECONDS, "PicoSeconds"),
    (d.RESERVED_FLAGS_2, "reserved bits"),
)
ACTION_FLAGS: Final[tuple[Flag, ...]] = (
    (a.HAS_RESPONSE_ADDRESS, "ResponseAddress"),
    (a.HAS_CORRELATION_DATA, "CorrelationData"),
    (a.HAS_REQUESTOR_ID, "RequestorId"),
    (a.HAS_TIMEOUT_HINT, "TimeoutHint"),
    (a.RESERVED_ACTION_FLAGS, "reserved bits"),
)
ACTION_STATES: Final[dict[int, str]] = {state: state.name.capitalize() for state in a.ActionState}
PROBE_TYPES: Final = {INFORMATION_PROBE: "Publisher information", FIND_APPLICATIONS_PROBE: "FindApplications"}
INFORMATION_TYPES: Final[dict[int, str]] = {
    ProbeKind.ENDPOINTS: "endpoints of the Publisher's server",
    ProbeKind.DATA_SET_META_DATA: "DataSetMetaData",
    ProbeKind.DATA_SET_WRITER_CONFIGURATION: "DataSetWriter configuration",
    ProbeKind.WRITER_GROUP_CONFIGURATION: "WriterGroup configuration",
    ProbeKind.PUBSUB_CONNECTIONS: "PubSubConnections",
}
APPLICATION_TYPES: Final = {DESCRIPTION: "application description", STATUS: "status"}

PROBE_FIELDS: Final[dict[int, tuple[tuple[str, ...], tuple[Shape, ...]]]] = {
    ProbeKind.DATA_SET_META_DATA: (("data_set_writer_ids",), (array(UINT16),)),
    ProbeKind.DATA_SET_WRITER_CONFIGURATION: (("data_set_writer_ids",), (array(UINT16),)),
    ProbeKind.WRITER_GROUP_CONFIGURATION: (("writer_group_id", "include_data_set_writers"), (UINT16, BOOLEAN)),
    ProbeKind.PUBSUB_CONNECTIONS: (
        ("transport_profile_uris", "include_writer_groups", "include_data_set_writers"),
        (array(STRING), BOOLEAN, BOOLEAN),
    ),
}
"""What follows the InformationType (tables 179 to 182)."""


def walk_data_set_messages(walk: MessageWalk, count: int) -> None:
    """The payload of a data message: sizes where there are several, then the DataSetMessages (7.2.4.5.3)."""
    if count == 1:
        walk.section = "DataSetMessage"
        _walk_data_set_message(walk)
        return
    sizes = [walk.number(f"Sizes[{index}]", BuiltinType.UINT16, " bytes") for index in range(count)]
    for index, size in enumerate(sizes):
        walk.section = f"DataSetMessage {index + 1} of {count}"
        _walk_data_set_message(walk.part(size))
    walk.padding()


def _walk_data_set_message(walk: MessageWalk) -> None:
    flags1 = walk.flags("DataSetFlags1", FLAGS_1, _flags_1_text)
    if not flags1 & d.IS_VALID:
        walk.rest("NotRead", "of a DataSetMessage that is not valid")
        return
    flags2 = walk.flags("DataSetFlags2", FLAGS_2, _flags_2_text) if flags1 & d.HAS_FLAGS_2 else 0
    if flags1 & d.HAS_SEQUENCE_NUMBER:
        walk.number("DataSetMessageSequenceNumber", BuiltinType.UINT16)
    if flags2 & d.HAS_TIMESTAMP:
        walk.number("Timestamp", BuiltinType.DATETIME)
    if flags2 & d.HAS_PICOSECONDS:
        walk.number("PicoSeconds", BuiltinType.UINT16, " x 10 ps")
    if flags1 & d.HAS_STATUS:
        walk.read("Status", lambda cursor: cursor.uint16() << 16, status_name)
    if flags1 & d.HAS_MAJOR_VERSION:
        walk.number("ConfigurationVersionMajorVersion", BuiltinType.UINT32)
    if flags1 & d.HAS_MINOR_VERSION:
        walk.number("ConfigurationVersionMinorVersion", BuiltinType.UINT32)
    _walk_fields(walk, (flags1 & d.FIELD_ENCODING_BITS) >> 1, flags2 & d.FRAME_KIND_BITS)


def _flags_1_text(flags: int) -> str:
    valid = "valid" if flags & d.IS_VALID else "not valid"
    return f"{valid}, fields are {FIELD_ENCODINGS[(flags & d.FIELD_ENCODING_BITS) >> 1]}"


def _flags_2_text(flags: int) -> str:
    kind = flags & d.FRAME_KIND_BITS
    return KINDS.get(kind, f"reserved type {kind}")


def _action_flags_text(flags: int) -> str:
    return "request" if flags & a.IS_REQUEST else "response"


def _walk_fields(walk: MessageWalk, encoding: int, kind: int) -> None:
    if kind in (d.FIRST_ACTION_KIND, d.LAST_ACTION_KIND):
        walk.number("ActionTargetId", BuiltinType.UINT16)
        walk.number("RequestId", BuiltinType.UINT16)
        walk.read("ActionState", Cursor.byte, _named(ACTION_STATES))
    if kind == FrameKind.KEEP_ALIVE:
        walk.padding()
        return
    if encoding == FieldEncoding.RAW_DATA:
        walk.rest("RawData", f"{walk.cursor.remaining} bytes, to be read with the DataSetMetaData")
        return
    if kind == FrameKind.KEY and not walk.cursor.remaining:
        return
    count = walk.number("FieldCount", BuiltinType.UINT16)
    for index in range(count):
        if kind == FrameKind.DELTA:
            walk.number(f"DeltaFrameFields[{index}].FieldIndex", BuiltinType.UINT16)
        name = f"DeltaFrameFields[{index}].FieldValue" if kind == FrameKind.DELTA else f"DataSetFields[{index}]"
        if encoding == FieldEncoding.DATA_VALUE:
            walk.data_value(name)
        else:
            walk.variant(name)
    walk.padding()


def walk_action_header(walk: MessageWalk) -> None:
    """The header of an Action (see `actions.py`)."""
    walk.section = "ActionHeader"
    flags = walk.flags("ActionFlags", ACTION_FLAGS, _action_flags_text)
    if flags & a.HAS_RESPONSE_ADDRESS:
        walk.value("ResponseAddress", BuiltinType.STRING)
    if flags & a.HAS_CORRELATION_DATA:
        walk.value("CorrelationData", BuiltinType.BYTE_STRING)
    if flags & a.HAS_REQUESTOR_ID:
        walk.variant("RequestorId")
    if flags & a.HAS_TIMEOUT_HINT:
        walk.number("TimeoutHint", BuiltinType.DOUBLE, " ms")


def walk_probe(walk: MessageWalk) -> None:
    """A discovery probe (7.2.4.6.12)."""
    walk.section = "Discovery probe"
    if walk.read("ProbeType", Cursor.byte, _named(PROBE_TYPES)) != INFORMATION_PROBE:
        walk.rest("NotRead")
        return
    kind = walk.read("InformationType", Cursor.byte, _named(INFORMATION_TYPES))
    fields = PROBE_FIELDS.get(kind)
    if fields is None:
        walk.rest("NotRead")
        return
    walk_fields(walk, *fields)
    walk.padding()


def walk_announcement(walk: MessageWalk) -> None:
    """A discovery announcement (7.2.4.6.2)."""
    walk.section = "Discovery announcement"
    kind = walk.read("AnnouncementType", Cursor.byte, _named(ANNOUNCEMENT_NAMES))
    walk.number("SequenceNumber", BuiltinType.UINT16)
    if kind == APPLICATION:
        _walk_application(walk)
    elif kind in BODIES:
        make, shapes = BODIES[kind]
        names: tuple[str, ...] = getattr(make, "_fields", ())
        walk_fields(walk, names[HEAD:], shapes)
        walk.padding()


def _walk_application(walk: MessageWalk) -> None:
    kind = walk.read("ApplicationInformationType", Cursor.uint16, _named(APPLICATION_TYPES))
    if kind == DESCRIPTION:
        walk_shape(walk, "ApplicationDescription", APPLICATION_DESCRIPTION)
        walk_shape(walk, "CapabilityIdentifiers", CAPABILITIES)
    elif kind == STATUS:
        is_cyclic = walk.read("IsCyclic", BOOLEAN.decode)
        walk.number("Status", BuiltinType.INT32)
        if is_cyclic:
            walk.number("NextReportTime", BuiltinType.DATETIME)
            walk.number("Timestamp", BuiltinType.DATETIME)
    else:
        walk.rest("Body")
        return
    walk.padding()


def _named(names: Mapping[int, str]) -> Callable[[int], str]:
    return lambda number: names.get(number) or f"reserved type {number}"
