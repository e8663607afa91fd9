"""Discovery probes (OPC 10000-14 7.2.4.6.12). The announcements that answer them are in `announcements.py`."""

from __future__ import annotations

from typing import Final

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.wire.announcements import META_DATA_TYPE, decode_announcement, encode_announcement
from ua_fleet.wire.builtin import MISFITS, decode_strings, decode_uint16s, encode_strings, encode_uint16s
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.header import Header, MessageType, encode_discovery_header
from ua_fleet.wire.messages import MetaDataAnnouncement, Probe, ProbeKind, PublisherIdType
from ua_fleet.wire.structure import BOOLEAN, UINT16

__all__ = [
    "decode_announcement",
    "decode_probe",
    "encode_announcement",
    "encode_metadata_announcement",
    "encode_probe",
]

INFORMATION_PROBE: Final = 1
FIND_APPLICATIONS_PROBE: Final = 2
"""ProbeTypes (table 178). The second has no further field, and a null PublisherId: all Publishers are asked."""
META_DATA: Final = META_DATA_TYPE

KINDS_WITH_WRITER_IDS: Final = (ProbeKind.DATA_SET_META_DATA, ProbeKind.DATA_SET_WRITER_CONFIGURATION)
INFORMATION_TYPES: Final = range(ProbeKind.ENDPOINTS, ProbeKind.PUBSUB_CONNECTIONS + 1)

NULL_PUBLISHER_ID: Final = bytes.fromhex("919404ffffffff000000000000")
"""The header of a probe whose PublisherId is null: only a String can be that. Then a security header that says None."""


def decode_probe(cursor: Cursor, header: Header) -> Probe:
    """Decode what follows the header of a discovery probe."""
    probe_type = cursor.byte()
    if probe_type == FIND_APPLICATIONS_PROBE:
        return Probe(None, PublisherIdType.STRING, ProbeKind.FIND_APPLICATIONS.value)
    if probe_type != INFORMATION_PROBE:
        raise RemoteWireError(Cause.PROBE_TYPE, f"ProbeType {probe_type}", cursor.position - 1)
    kind = cursor.byte()
    if kind not in INFORMATION_TYPES:
        raise RemoteWireError(Cause.PROBE_TYPE, f"InformationType {kind}", cursor.position - 1)
    probe = Probe(header.publisher_id, header.publisher_id_type, kind)
    if kind == ProbeKind.ENDPOINTS:
        return probe  # version 1.04 has a null array behind it
    if kind in KINDS_WITH_WRITER_IDS:
        probe = probe._replace(data_set_writer_ids=decode_uint16s(cursor))
    elif kind == ProbeKind.WRITER_GROUP_CONFIGURATION:
        probe = probe._replace(writer_group_id=cursor.uint16(), include_data_set_writers=BOOLEAN.decode(cursor))
    else:
        probe = probe._replace(
            transport_profile_uris=decode_strings(cursor),
            include_writer_groups=BOOLEAN.decode(cursor),
            include_data_set_writers=BOOLEAN.decode(cursor),
        )
    cursor.expect_padding()
    return probe


def encode_probe(probe: Probe) -> bytes:
    """The datagram of a probe of any kind; raises LocalWireError on what cannot be encoded."""
    out = bytearray()
    try:
        _encode_probe(out, probe)
    except MISFITS as error:
        raise LocalWireError(f"a probe that is not put together right: {error}") from error
    return bytes(out)


def _encode_probe(out: bytearray, probe: Probe) -> None:
    kind = probe.kind
    if kind == ProbeKind.FIND_APPLICATIONS:
        out += NULL_PUBLISHER_ID
        out.append(FIND_APPLICATIONS_PROBE)
        return
    if kind not in INFORMATION_TYPES:
        raise LocalWireError(f"there are no probes of kind {kind}")
    encode_discovery_header(out, MessageType.PROBE, probe.publisher_id, probe.publisher_id_type)
    out += bytes((INFORMATION_PROBE, kind))
    if kind in KINDS_WITH_WRITER_IDS:
        encode_uint16s(out, probe.data_set_writer_ids)
    elif kind == ProbeKind.WRITER_GROUP_CONFIGURATION:
        UINT16.encode(out, probe.writer_group_id)
        BOOLEAN.encode(out, probe.include_data_set_writers)
    elif kind == ProbeKind.PUBSUB_CONNECTIONS:
        encode_strings(out, probe.transport_profile_uris)
        BOOLEAN.encode(out, probe.include_writer_groups)
        BOOLEAN.encode(out, probe.include_data_set_writers)


def encode_metadata_announcement(announcement: MetaDataAnnouncement) -> bytes:
    """The datagram that announces the metadata of a DataSetWriter."""
    return encode_announcement(announcement)
