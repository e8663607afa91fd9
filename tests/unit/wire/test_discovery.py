"""Probes and announcements as bytes, worked out from OPC 10000-14 7.2.4.6."""

from __future__ import annotations

import pytest

from tests.unit.wire.corpus import FULL_METADATA as FULL
from tests.unit.wire.corpus import MINIMAL_METADATA as MINIMAL
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import QualifiedName
from ua_fleet.wire import Codec, SecuredMessage, encode_metadata_announcement, encode_probe
from ua_fleet.wire.messages import (
    Announcement,
    ConfigurationVersion,
    DataSetMetaData,
    FieldMetaData,
    MetaDataAnnouncement,
    Probe,
    ProbeKind,
    PublisherIdType,
)

PROBE_HEAD = "91 91 04 0700 00 00000000 00"
ANNOUNCEMENT_HEAD = "91 91 08 0700 00 00000000 00"
U16 = PublisherIdType.UINT16

PROBES: list[tuple[str, Probe, str]] = [
    ("all metadata", Probe(7, U16, ProbeKind.DATA_SET_META_DATA), PROBE_HEAD + "01 02 00000000"),
    (
        "metadata of two writers",
        Probe(7, U16, ProbeKind.DATA_SET_META_DATA, (1, 0xABCD)),
        PROBE_HEAD + "01 02 02000000 0100 cdab",
    ),
    (
        "writer configuration",
        Probe(7, U16, ProbeKind.DATA_SET_WRITER_CONFIGURATION, (1,)),
        PROBE_HEAD + "01 03 01000000 0100",
    ),
    ("endpoints", Probe(7, U16, ProbeKind.ENDPOINTS), PROBE_HEAD + "01 01"),
    ("of a UInt64 publisher", Probe(7, 3, ProbeKind.ENDPOINTS), "91 93 04 0700000000000000 00 00000000 00 01 01"),
    (
        "WriterGroup",
        Probe(7, U16, ProbeKind.WRITER_GROUP_CONFIGURATION, writer_group_id=3, include_data_set_writers=True),
        PROBE_HEAD + "01 04 0300 01",
    ),
    ("connections", Probe(7, U16, ProbeKind.PUBSUB_CONNECTIONS), PROBE_HEAD + "01 05 00000000 00 00"),
    (
        "connections of one transport with their groups",
        Probe(7, U16, ProbeKind.PUBSUB_CONNECTIONS, transport_profile_uris=("a", "bc"), include_writer_groups=True),
        PROBE_HEAD + "01 05 02000000 01000000 61 02000000 6263 01 00",
    ),
    (
        "applications",
        Probe(None, PublisherIdType.STRING, ProbeKind.FIND_APPLICATIONS),
        "91 94 04 ffffffff 00 00000000 00 02",
    ),
    ("of a String publisher", Probe("a", 4, ProbeKind.ENDPOINTS), "91 94 04 01000000 61 00 00000000 00 01 01"),
]


@pytest.mark.parametrize(("probe", "encoded"), [pytest.param(*row[1:], id=row[0]) for row in PROBES])
def test_probes(probe: Probe, encoded: str) -> None:
    data = bytes.fromhex(encoded)
    assert Codec().decode(data) == probe
    assert encode_probe(probe) == data


@pytest.mark.parametrize(
    ("rest", "kind"),
    [
        pytest.param("01 02 ffffffff", ProbeKind.DATA_SET_META_DATA, id="null list of writers"),
        pytest.param("01 01 ffffffff", ProbeKind.ENDPOINTS, id="version 1.04 sends a null list here"),
        pytest.param("01 05 ffffffff 00 00", ProbeKind.PUBSUB_CONNECTIONS, id="connections"),
    ],
)
def test_probes_that_only_peers_send(rest: str, kind: ProbeKind) -> None:
    assert Codec().decode(bytes.fromhex(PROBE_HEAD + rest)) == Probe(7, U16, kind)


def test_a_security_header_that_says_none_may_have_a_nonce() -> None:
    data = bytes.fromhex("91 91 04 0700 00 01000000 08 0102030405060708 01 01")
    assert Codec().decode(data) == Probe(7, U16, ProbeKind.ENDPOINTS)


def test_discovery_without_a_security_header() -> None:
    """Version 1.04 left the security flag of discovery messages open."""
    assert Codec().decode(bytes.fromhex("91 81 04 0700 01 01")) == Probe(7, U16, ProbeKind.ENDPOINTS)


@pytest.mark.parametrize("flags", ["01", "02", "03", "10"])
def test_secured_discovery_is_refused(flags: str) -> None:
    """With keys configured an unsigned announcement is worth nothing, and one that is signed cannot be checked here."""
    with pytest.raises(SecuredMessage):
        Codec().decode(bytes.fromhex(f"91 91 08 0700 {flags} 01000000 00 01 0000"))


FIELD = MINIMAL.fields[0]
FIELD_HEX = "01000000 78 00 0000 0b 00 0b ffffffff 00000000 00000000" + "00" * 16 + "00000000"
MINIMAL_HEX = (
    "00000000 00000000 00000000 00000000 01000000 6e 00 01000000" + FIELD_HEX + "00" * 16 + "01000000 02000000"
)


@pytest.mark.parametrize("metadata", [MINIMAL, FULL], ids=["minimal", "full"])
def test_metadata_announcement(metadata: DataSetMetaData) -> None:
    announcement = MetaDataAnnouncement(7, U16, 3, 1001, metadata, status=0x8031_0000)
    data = encode_metadata_announcement(announcement)
    assert Codec().decode(data) == announcement
    assert data.startswith(bytes.fromhex(ANNOUNCEMENT_HEAD + "02 0300 e903"))
    assert data.endswith(bytes.fromhex("00003180"))
    if metadata is MINIMAL:
        assert data[len(bytes.fromhex(ANNOUNCEMENT_HEAD)) + 5 : -4] == bytes.fromhex(MINIMAL_HEX)


def test_other_announcements_are_kept_unread() -> None:
    data = bytes.fromhex(ANNOUNCEMENT_HEAD + "05 0900 0102")
    assert Codec().decode(data) == Announcement(7, U16, 5, 9, b"\1\2")


def test_every_truncation_is_refused() -> None:
    data = encode_metadata_announcement(MetaDataAnnouncement(7, U16, 3, 1001, FULL))
    for size in range(len(data)):
        with pytest.raises(RemoteWireError):
            Codec().decode(data[:size])


@pytest.mark.parametrize(
    "probe",
    [
        Probe(7, U16, 6),
        Probe(7, U16, ProbeKind.PUBSUB_CONNECTIONS, transport_profile_uris=(5,)),  # type: ignore[arg-type]
        Probe(7, U16, ProbeKind.WRITER_GROUP_CONFIGURATION, writer_group_id=70_000),
        Probe(None, U16, ProbeKind.ENDPOINTS),
        Probe(None, PublisherIdType.STRING, ProbeKind.ENDPOINTS),
        Probe(7, 5, ProbeKind.ENDPOINTS),
        Probe(70_000, U16, ProbeKind.ENDPOINTS),
        Probe(7, U16, ProbeKind.DATA_SET_META_DATA, (70_000,)),
        Probe(7, U16, ProbeKind.DATA_SET_META_DATA, None),  # type: ignore[arg-type]
    ],
)
def test_probes_that_cannot_be_sent(probe: Probe) -> None:
    with pytest.raises(LocalWireError):
        encode_probe(probe)


@pytest.mark.parametrize(
    "metadata",
    [
        MINIMAL._replace(fields=(FieldMetaData("x", 0),)),
        MINIMAL._replace(fields=(FieldMetaData("x", 26),)),
        MINIMAL._replace(fields=(FIELD._replace(properties=((QualifiedName(0, "a"), 3, 256),)),)),
        MINIMAL._replace(fields=(FIELD._replace(array_dimensions=(-1,)),)),
        MINIMAL._replace(fields=None),  # type: ignore[arg-type]
        MINIMAL._replace(name=5),  # type: ignore[arg-type]
        MINIMAL._replace(configuration_version=ConfigurationVersion(-1, 0)),
    ],
)
def test_metadata_that_cannot_be_sent(metadata: DataSetMetaData) -> None:
    with pytest.raises(LocalWireError):
        encode_metadata_announcement(MetaDataAnnouncement(7, U16, 3, 1001, metadata))
