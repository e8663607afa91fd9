"""Announcements of every kind as bytes, worked out from OPC 10000-14 7.2.4.6."""

from __future__ import annotations

import random
import struct
from collections import Counter

import pytest

from tests.unit.wire.corpus import MINIMAL_METADATA, mutate
from tests.unit.wire.discovery_samples import ANNOUNCEMENTS, METHOD
from ua_fleet.errors import RemoteWireError
from ua_fleet.values import LocalizedText, QualifiedName, Variant
from ua_fleet.wire import Cause, Codec, encode_announcement
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    ActionResponderAnnouncement,
    ActionTarget,
    AnyAnnouncement,
    ApplicationAnnouncement,
    ApplicationDescription,
    ApplicationType,
    ConnectionsAnnouncement,
    DataSetWriter,
    PubSubConnection,
    PubSubState,
    StatusAnnouncement,
    UadpWriterGroupMessage,
    WriterConfigurationAnnouncement,
    WriterGroup,
)
from ua_fleet.wire.messages import FieldMetaData, MetaDataAnnouncement, PublisherIdType

U16 = PublisherIdType.UINT16
HEAD = "91 91 08 0700 00 00000000 00"


@pytest.mark.parametrize("name", ANNOUNCEMENTS)
def test_what_is_encoded_is_decoded(name: str) -> None:
    announcement = ANNOUNCEMENTS[name]
    data = encode_announcement(announcement)
    assert Codec().decode(data) == announcement
    assert Codec().decode(data + bytes(3)) is not None  # padding
    for size in range(len(data) - 1):
        if name != "application information of another edition" or size < len(data) - 3:
            with pytest.raises(RemoteWireError):
                Codec().decode(data[:size])


METADATA_BYTES = (
    "00000000 00000000 00000000 00000000 01000000 6e 00 01000000"
    "01000000 78 00 0000 0b 00 0b ffffffff 00000000 00000000" + "00" * 16 + "00000000" + "00" * 16 + "01000000 02000000"
)

BYTES: list[tuple[str, AnyAnnouncement, str]] = [
    ("no endpoints", ANNOUNCEMENTS["no endpoints"], HEAD + "01 0300 00000000 00003d80"),
    (
        "cyclic status",
        StatusAnnouncement(7, U16, 3, True, PubSubState.OPERATIONAL, 2, 1),
        HEAD + "05 0300 0200 01 02000000 0200000000000000 0100000000000000",
    ),
    ("last status", ANNOUNCEMENTS["status"], HEAD + "05 0300 0200 00 00000000"),
    (
        "application",
        ApplicationAnnouncement(
            7, U16, 3, ApplicationDescription("u", None, LocalizedText("n"), ApplicationType.CLIENT), ("DA",)
        ),
        HEAD + "05 0300 0100 01000000 75 ffffffff 02 01000000 6e 01000000 ffffffff ffffffff 00000000"
        "01000000 02000000 4441",
    ),
    ("no connections", ConnectionsAnnouncement(7, U16, 3, ()), HEAD + "04 0300 00000000"),
    (
        "responder",
        ActionResponderAnnouncement(7, U16, 3, (PubSubConnection("c", True, Variant(5, 7), None),)),
        HEAD + "06 0300 01000000 01000000 63 01 05 0700 ffffffff 000000 00000000 000000 00000000 00000000",
    ),
    (
        "writers",
        WriterConfigurationAnnouncement(
            7, U16, 3, (9,), WriterGroup(None, True, data_set_writers=(DataSetWriter("w", True, 9),)), (0,)
        ),
        HEAD + "03 0300 01000000 0900 ffffffff 01 01000000 ffffffff 00000000 00000000 00000000 0000"
        "0000000000000000 0000000000000000 00 00000000 ffffffff 000000 000000"
        "01000000 01000000 77 01 0900 00000000 01000000 ffffffff 00000000 000000 000000"
        "01000000 00000000",
    ),
    (
        "actions",
        ActionMetaDataAnnouncement(
            7, U16, 3, 9, (ActionTarget(1, "t"),), MINIMAL_METADATA, MINIMAL_METADATA, (METHOD,)
        ),
        HEAD + "07 0300 0900 01000000 0100 01000000 74 00" + METADATA_BYTES + METADATA_BYTES + "01000000"
        "03 0200 05000000 726f626f74 01 02 0900",
    ),
]


@pytest.mark.parametrize(("announcement", "encoded"), [pytest.param(*row[1:], id=row[0]) for row in BYTES])
def test_bytes(announcement: AnyAnnouncement, encoded: str) -> None:
    data = bytes.fromhex(encoded)
    assert encode_announcement(announcement).hex() == data.hex()
    assert Codec().decode(data) == announcement


def test_lists_that_belong_together_have_the_same_length() -> None:
    group = WriterGroup(None, True)
    methods = ActionMetaDataAnnouncement(7, U16, 3, 9, (), MINIMAL_METADATA, MINIMAL_METADATA, (METHOD,))
    for announcement in (WriterConfigurationAnnouncement(7, U16, 3, (1, 2), group, (0,)), methods):
        assert cause_of(encode_announcement(announcement)) == Cause.ANNOUNCEMENT_COUNTS


@pytest.mark.parametrize("count", [65_535, 0x7FFF_FFFF, -2, -0x8000_0000])
def test_counts_that_lie(count: int) -> None:
    """Nothing is allocated for what a count announces beyond the bytes that are there."""
    lie = struct.pack("<i", count)
    for name, announcement in ANNOUNCEMENTS.items():
        data = encode_announcement(announcement)
        causes = {cause_of(data[:at] + lie + data[at + 4 :]) for at in range(len(data) - 4)}
        assert causes <= {None, *Cause}, name
        if count < 0 and name in ("endpoints", "writers", "connections", "responder", "actions"):
            assert Cause.NEGATIVE_LENGTH in causes


def cause_of(data: bytes) -> str | None:
    try:
        Codec().decode(data)
    except RemoteWireError as error:
        return error.cause
    return None


def test_more_elements_than_there_can_be() -> None:
    """A structure costs many times the memory of its bytes, and a message of chunks may have megabytes."""
    targets = tuple([ActionTarget(number, None) for number in range(40_000)])
    methods = (METHOD,) * 40_000
    action = ActionMetaDataAnnouncement(7, U16, 3, 9, targets, MINIMAL_METADATA, MINIMAL_METADATA)
    assert cause_of(encode_announcement(action)) is None
    assert cause_of(encode_announcement(action._replace(methods=methods))) is None
    lots = action._replace(targets=targets * 2, methods=methods * 2)
    assert cause_of(encode_announcement(lots)) == Cause.TOO_MANY
    offsets = UadpWriterGroupMessage(publishing_offset=(0.0,) * 60_000)
    group = WriterGroup(None, True, message_settings=offsets)
    connection = PubSubConnection(None, True, Variant(3, 7), None, writer_groups=(group, group))
    one = ConnectionsAnnouncement(7, U16, 3, (connection._replace(writer_groups=(group,)),))
    assert cause_of(encode_announcement(one)) is None
    assert cause_of(encode_announcement(one._replace(connections=(connection,)))) == Cause.TOO_MANY


@pytest.mark.parametrize("properties", [0, 1])
def test_metadata_of_more_fields_than_we_read(properties: int) -> None:
    """20,000 fields took half a second to read: two such messages a second stopped a server."""
    field = FieldMetaData("f", 11, properties=((QualifiedName(0, "p"), 6, 1),) * properties)
    most = 2_000 // (1 + properties)
    metadata = MINIMAL_METADATA._replace(fields=(field,) * most)
    announcement = MetaDataAnnouncement(7, U16, 3, 9, metadata)
    assert cause_of(encode_announcement(announcement)) is None
    more = metadata._replace(fields=(field,) * (most + 1))
    assert cause_of(encode_announcement(announcement._replace(metadata=more))) == Cause.TOO_MANY


def test_values_nested_too_deep() -> None:
    deep = b"\x98\x01\0\0\0" * 100 + b"\3\x77"
    connection = PubSubConnection(None, True, Variant(3, 0x77), None)
    data = encode_announcement(ConnectionsAnnouncement(7, U16, 3, (connection,)))
    assert cause_of(data.replace(b"\3\x77", deep)) == Cause.TOO_DEEP


@pytest.mark.parametrize("name", ANNOUNCEMENTS)
def test_only_the_typed_remote_error_escapes(name: str) -> None:
    chance = random.Random(name)
    codec = Codec()
    corpus = [encode_announcement(ANNOUNCEMENTS[name])]
    causes: Counter[str] = Counter()
    for _ in range(3_000):
        try:
            codec.decode(mutate(chance, corpus))
        except RemoteWireError as error:
            causes[error.cause] += 1
        else:
            causes["decoded"] += 1
    assert set(causes) - {"decoded"} <= set(Cause)
