"""Discovery: probes and announcements (OPC 10000-14 7.2.4.6)."""

from __future__ import annotations

from typing import Final

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType
from ua_fleet.wire.builtin import MISFITS, decode_uint16s, encode_number, encode_uint16s
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.header import Header, MessageType, encode_discovery_header
from ua_fleet.wire.messages import Announcement, MetaDataAnnouncement, Probe, ProbeKind
from ua_fleet.wire.metadata import decode_metadata, encode_metadata

__all__ = ["decode_announcement", "decode_probe", "encode_metadata_announcement", "encode_probe"]

INFORMATION_PROBE: Final = 1
"""ProbeType of a Publisher information probe (7.2.4.6.12.3); 2, FindApplications, asks servers, not Publishers."""
META_DATA: Final = 2
LAST_ANNOUNCEMENT_TYPE: Final = 7
"""AnnouncementTypes 1 to 7 (table 168)."""

KINDS_WITH_WRITER_IDS: Final = (ProbeKind.DATA_SET_META_DATA, ProbeKind.DATA_SET_WRITER_CONFIGURATION)


def decode_probe(cursor: Cursor, header: Header) -> Probe:
    """Decode what follows the header of a discovery probe."""
    probe_type = cursor.byte()
    if probe_type != INFORMATION_PROBE:
        raise RemoteWireError(Cause.PROBE_TYPE, f"ProbeType {probe_type}", cursor.position - 1)
    kind = cursor.byte()
    if not ProbeKind.ENDPOINTS <= kind <= ProbeKind.PUBSUB_CONNECTIONS:
        raise RemoteWireError(Cause.PROBE_TYPE, f"InformationType {kind}", cursor.position - 1)
    writer_ids: tuple[int, ...] = ()
    if kind in KINDS_WITH_WRITER_IDS:
        writer_ids = decode_uint16s(cursor)
        cursor.expect_padding()
    return Probe(header.publisher_id, header.publisher_id_type, kind, writer_ids)


def decode_announcement(cursor: Cursor, header: Header) -> MetaDataAnnouncement | Announcement:
    """Decode what follows the header of a discovery announcement."""
    kind = cursor.byte()
    if not 1 <= kind <= LAST_ANNOUNCEMENT_TYPE:
        raise RemoteWireError(Cause.ANNOUNCEMENT_TYPE, f"AnnouncementType {kind}", cursor.position - 1)
    sequence_number = cursor.uint16()
    if kind != META_DATA:
        body = cursor.take(cursor.remaining)
        return Announcement(header.publisher_id, header.publisher_id_type, kind, sequence_number, body)
    data_set_writer_id = cursor.uint16()
    metadata = decode_metadata(cursor)
    status = cursor.uint32()
    cursor.expect_padding()
    return MetaDataAnnouncement(
        header.publisher_id, header.publisher_id_type, sequence_number, data_set_writer_id, metadata, status
    )


def encode_probe(probe: Probe) -> bytes:
    """The datagram of a Publisher information probe for metadata, writer configurations or endpoints."""
    if probe.kind not in (ProbeKind.ENDPOINTS, *KINDS_WITH_WRITER_IDS):
        raise LocalWireError(f"probes of kind {probe.kind} are not sent")
    out = bytearray()
    try:
        encode_discovery_header(out, MessageType.PROBE, probe.publisher_id, probe.publisher_id_type)
        out += bytes((INFORMATION_PROBE, probe.kind))
        if probe.kind in KINDS_WITH_WRITER_IDS:
            encode_uint16s(out, probe.data_set_writer_ids)
    except MISFITS as error:
        raise LocalWireError(f"a probe that is not put together right: {error}") from error
    return bytes(out)


def encode_metadata_announcement(announcement: MetaDataAnnouncement) -> bytes:
    """The datagram that announces the metadata of a DataSetWriter."""
    out = bytearray()
    publisher = announcement.publisher_id, announcement.publisher_id_type
    try:
        encode_discovery_header(out, MessageType.ANNOUNCEMENT, *publisher)
        out.append(META_DATA)
        encode_number(out, BuiltinType.UINT16, announcement.sequence_number)
        encode_number(out, BuiltinType.UINT16, announcement.data_set_writer_id)
        encode_metadata(out, announcement.metadata)
        encode_number(out, BuiltinType.STATUS_CODE, announcement.status)
    except MISFITS as error:
        raise LocalWireError(f"metadata that is not put together right: {error}") from error
    return bytes(out)
