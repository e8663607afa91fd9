"""Discovery announcements: what follows their header (OPC 10000-14 7.2.4.6.3 to 7.2.4.6.11)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType
from ua_fleet.wire import discovered as d
from ua_fleet.wire.builtin import MISFITS, encode_number
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.configuration import (
    ACTION_METHOD,
    ACTION_TARGET,
    APPLICATION_DESCRIPTION,
    CONNECTION,
    ENDPOINT_DESCRIPTION,
    META_DATA,
    WRITER_GROUP,
)
from ua_fleet.wire.cursor import BoundedCursor, Cursor
from ua_fleet.wire.header import Header, MessageType, encode_discovery_header
from ua_fleet.wire.messages import Announcement, MetaDataAnnouncement
from ua_fleet.wire.structure import BOOLEAN, ENUMERATION, STATUS_CODE, TEXT, TIME, UINT16, Shape, array

__all__ = ["ANNOUNCEMENT_NAMES", "APPLICATION", "META_DATA_TYPE", "decode_announcement", "encode_announcement"]

ENDPOINTS: Final = 1
META_DATA_TYPE: Final = 2
WRITER_CONFIGURATION: Final = 3
CONNECTIONS: Final = 4
APPLICATION: Final = 5
ACTION_RESPONDER: Final = 6
ACTION_META_DATA: Final = 7

ANNOUNCEMENT_NAMES: Final[dict[int, str]] = {
    ENDPOINTS: "Publisher Endpoints",
    META_DATA_TYPE: "DataSetMetaData",
    WRITER_CONFIGURATION: "DataSetWriter configuration",
    CONNECTIONS: "PubSubConnection configuration",
    APPLICATION: "OPC UA Application information",
    ACTION_RESPONDER: "ActionResponder configuration",
    ACTION_META_DATA: "ActionMetaData",
}
"""AnnouncementTypes (table 168)."""

DESCRIPTION: Final = 1
STATUS: Final = 2
"""ApplicationInformationTypes (table 169)."""

CAPABILITIES: Final = array(TEXT)
HEAD: Final = 3
"""Fields that announcements of each type have first: PublisherId, its type, SequenceNumber."""

BODIES: Final[dict[int, tuple[Callable[..., Any], tuple[Shape, ...]]]] = {
    ENDPOINTS: (d.EndpointsAnnouncement, (array(ENDPOINT_DESCRIPTION), STATUS_CODE)),
    META_DATA_TYPE: (MetaDataAnnouncement, (UINT16, META_DATA, STATUS_CODE)),
    WRITER_CONFIGURATION: (d.WriterConfigurationAnnouncement, (array(UINT16), WRITER_GROUP, array(STATUS_CODE))),
    CONNECTIONS: (d.ConnectionsAnnouncement, (array(CONNECTION),)),
    ACTION_RESPONDER: (d.ActionResponderAnnouncement, (array(CONNECTION),)),
    ACTION_META_DATA: (
        d.ActionMetaDataAnnouncement,
        (UINT16, array(ACTION_TARGET), META_DATA, META_DATA, array(ACTION_METHOD)),
    ),
}
"""What an announcement of each type becomes, and the fields that follow its SequenceNumber, but for the type 5."""

TYPES: Final = {make: kind for kind, (make, _) in BODIES.items()}


def decode_announcement(cursor: Cursor, header: Header) -> d.AnyAnnouncement:
    """Decode what follows the header of a discovery announcement."""
    cursor = BoundedCursor(cursor.data, cursor.position, cursor.end)
    kind = cursor.byte()
    if kind not in ANNOUNCEMENT_NAMES:
        raise RemoteWireError(Cause.ANNOUNCEMENT_TYPE, f"AnnouncementType {kind}", cursor.position - 1)
    head = header.publisher_id, header.publisher_id_type, cursor.uint16()
    if kind == APPLICATION:
        return _decode_application(cursor, *head)
    make, fields = BODIES[kind]
    announcement: d.AnyAnnouncement = make(*head, *[field.decode(cursor) for field in fields])
    cursor.expect_padding()
    _check_counts(announcement, cursor.position)
    return announcement


def _check_counts(announcement: d.AnyAnnouncement, offset: int) -> None:
    """Two lists that belong together have the same length (tables 175 and 177)."""
    if isinstance(announcement, d.WriterConfigurationAnnouncement):
        counts = len(announcement.data_set_writer_ids), len(announcement.statuses)
    elif isinstance(announcement, d.ActionMetaDataAnnouncement) and announcement.methods:
        counts = len(announcement.targets), len(announcement.methods)
    else:
        return
    if counts[0] != counts[1]:
        raise RemoteWireError(Cause.ANNOUNCEMENT_COUNTS, f"{counts[0]} and {counts[1]} elements", offset)


def _decode_application(
    cursor: Cursor, publisher_id: int | str | None, publisher_id_type: int, number: int
) -> d.AnyAnnouncement:
    start = cursor.position
    kind = cursor.uint16()
    announcement: d.AnyAnnouncement
    if kind == DESCRIPTION:
        description = APPLICATION_DESCRIPTION.decode(cursor)
        capabilities = CAPABILITIES.decode(cursor)
        announcement = d.ApplicationAnnouncement(publisher_id, publisher_id_type, number, description, capabilities)
    elif kind == STATUS:
        is_cyclic = BOOLEAN.decode(cursor)
        state = cursor.int32()
        times = (TIME.decode(cursor), TIME.decode(cursor)) if is_cyclic else ()
        announcement = d.StatusAnnouncement(publisher_id, publisher_id_type, number, is_cyclic, state, *times)
    else:
        cursor.position = start
        body = cursor.take(cursor.remaining)
        return Announcement(publisher_id, publisher_id_type, APPLICATION, number, body)
    cursor.expect_padding()
    return announcement


def encode_announcement(announcement: d.AnyAnnouncement) -> bytes:
    """The datagram of an announcement of any type; raises LocalWireError on what cannot be encoded."""
    out = bytearray()
    try:
        encode_discovery_header(
            out, MessageType.ANNOUNCEMENT, announcement.publisher_id, announcement.publisher_id_type
        )
        out.append(TYPES.get(type(announcement), APPLICATION))
        encode_number(out, BuiltinType.UINT16, announcement.sequence_number)
        _encode_body(out, announcement)
    except MISFITS as error:
        raise LocalWireError(f"an announcement that is not put together right: {error}") from error
    return bytes(out)


def _encode_body(out: bytearray, announcement: d.AnyAnnouncement) -> None:
    if isinstance(announcement, Announcement):
        if announcement.kind != APPLICATION:
            raise LocalWireError(f"announcements of type {announcement.kind} are not made of bytes")
        out += announcement.body
    elif isinstance(announcement, d.ApplicationAnnouncement):
        encode_number(out, BuiltinType.UINT16, DESCRIPTION)
        APPLICATION_DESCRIPTION.encode(out, announcement.description)
        CAPABILITIES.encode(out, announcement.capabilities)
    elif isinstance(announcement, d.StatusAnnouncement):
        encode_number(out, BuiltinType.UINT16, STATUS)
        BOOLEAN.encode(out, announcement.is_cyclic)
        ENUMERATION.encode(out, announcement.state)
        if announcement.is_cyclic:
            TIME.encode(out, announcement.next_report_time)
            TIME.encode(out, announcement.timestamp)
    else:
        _, fields = BODIES[TYPES[type(announcement)]]
        for field, value in zip(fields, announcement[HEAD:], strict=True):
            field.encode(out, value)
