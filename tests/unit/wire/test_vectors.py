"""What open62541 sent, and what was built by hand from the tables: decoded, and encoded again to the same bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ua_fleet.errors import RemoteWireError
from ua_fleet.wire import (
    Codec,
    MessageKey,
    SecuredMessage,
    SecurityMode,
    SecurityPolicy,
    decode_raw_fields,
    encode_announcement,
    encode_probe,
    join,
    payload_offset,
    read_chunk,
    read_security,
    split,
)
from ua_fleet.wire.discovered import EndpointsAnnouncement
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldEncoding,
    FieldMetaData,
    FrameKind,
    NetworkMessage,
    Probe,
    ProbeKind,
    PublisherIdType,
)

VECTORS = Path(__file__).parents[2] / "vectors"
STAMP = 133_500_000_000_000_000
TYPES = (11, 6, 1, 13, 12)
FLAGS = (True, True, False, True)
"""The Flag of the four messages in each capture; the Counter counts them."""
METADATA = DataSetMetaData(
    "peer",
    (
        FieldMetaData("Temp", 11),
        FieldMetaData("Counter", 6),
        FieldMetaData("Flag", 1),
        FieldMetaData("Stamp", 13),
        FieldMetaData("Text", 12, max_string_length=16),
    ),
    ConfigurationVersion(1, 1),
)


def capture(name: str) -> list[bytes]:
    return [bytes.fromhex(line) for line in (VECTORS / f"{name}.hex").read_text(encoding="ascii").split()]


def built(name: str) -> dict[str, bytes]:
    lines = (VECTORS / f"{name}.tsv").read_text(encoding="ascii").splitlines()
    return {key: bytes.fromhex(data) for key, data in (line.split("\t") for line in lines)}


def decode(data: bytes) -> NetworkMessage:
    decoded = Codec().decode(data)
    assert isinstance(decoded, NetworkMessage)
    return decoded


def peer_message(**fields: Any) -> NetworkMessage:
    part = DataSetMessage(62541, types=TYPES)._replace(**fields)
    return NetworkMessage(2234, PublisherIdType.UINT16, writer_group_id=100, messages=(part,))


def peer_values(counter: int) -> tuple[object, ...]:
    return (21.5, counter, FLAGS[counter], STAMP, "robot-7")


def test_peer_variant() -> None:
    codec = Codec()
    for counter, data in enumerate(capture("peer_none")):
        expected = peer_message(values=peer_values(counter))
        assert codec.decode(data) == expected
        assert codec.encode(expected) == data


def test_peer_data_value() -> None:
    codec = Codec()
    for counter, data in enumerate(capture("peer_datavalue")):
        decoded = codec.decode(data)
        assert isinstance(decoded, NetworkMessage)
        times = decoded.messages[0].field_source_timestamps
        assert times is not None
        assert len(set(times)) == 5
        assert all(134_397_109_719_795_000 < (time or 0) < 134_397_109_723_806_000 for time in times)
        expected = peer_message(
            values=peer_values(counter),
            encoding=FieldEncoding.DATA_VALUE,
            field_status=(0,) * 5,
            field_source_timestamps=times,
        )
        assert decoded == expected
        assert codec.encode(expected) == data


def test_peer_raw() -> None:
    codec = Codec()
    for counter, data in enumerate(capture("peer_raw")):
        decoded = codec.decode(data)
        assert isinstance(decoded, NetworkMessage)
        assert codec.encode(decoded) == data
        fields = decode_raw_fields(decoded.messages[0], METADATA)
        assert (fields.types, fields.values, fields.raw) == (TYPES, peer_values(counter), None)


def test_tutorial_publisher() -> None:
    codec = Codec()
    times: list[int] = []
    for data in capture("plain_mc"):
        decoded = codec.decode(data)
        assert isinstance(decoded, NetworkMessage)
        (part,) = decoded.messages
        assert part.timestamp is not None
        expected = DataSetMessage(
            62541,
            types=(13,),
            values=part.values,
            timestamp=part.timestamp,
            major_version=1_941_601_911,
            minor_version=1_941_600_954,
        )
        assert decoded == NetworkMessage(2234, writer_group_id=100, messages=(expected,))
        assert 0 < part.values[0] - part.timestamp < 1000  # it sends its clock
        assert codec.encode(decoded) == data
        times.append(part.timestamp)
    assert times == sorted(times)


@pytest.mark.parametrize("name", ["peer_enc128", "peer_sign256"])
def test_secured_messages_are_never_read_as_data(name: str) -> None:
    codec = Codec()
    for data in capture(name):
        with pytest.raises(SecuredMessage) as caught:
            codec.decode(data)
        assert caught.value.cause == "secured"


def key(policy: SecurityPolicy) -> MessageKey:
    return MessageKey(policy, bytes(range(policy.key_data_bytes)))


@pytest.mark.parametrize(
    ("name", "policy", "mode"),
    [
        ("peer_enc128", SecurityPolicy.AES128_CTR, SecurityMode.SIGN_AND_ENCRYPT),
        ("peer_sign256", SecurityPolicy.AES256_CTR, SecurityMode.SIGN),
    ],
)
def test_peer_secured(name: str, policy: SecurityPolicy, mode: SecurityMode) -> None:
    codec, opener, sender = Codec(), key(policy), key(policy)
    for counter, data in enumerate(capture(name)):
        heard = read_security(data)
        assert heard[1:9] == (2234, PublisherIdType.UINT16, 100, (62541,), False, False, mode, 1)
        assert heard.nonce[4:] == b"\1\0\0\0"  # the peer counts its nonces no further
        assert not heard.force_key_reset
        plain = opener.unprotect(heard)
        expected = peer_message(values=peer_values(counter))
        assert codec.decode(plain) == expected
        assert codec.encode(expected) == plain
        assert sender.protect(plain, payload_offset(plain), 1, heard.nonce, mode) == data


def one(part: DataSetMessage, publisher_id: int | str = 7, **header: Any) -> NetworkMessage:
    return NetworkMessage(publisher_id, PublisherIdType.UINT16, messages=(part,))._replace(**header)


CONFIRMED = {
    "V1_minimal_byte_pid": one(
        DataSetMessage(0, types=(11,), values=(1.5,)), publisher_id_type=PublisherIdType.BYTE, payload_header=False
    ),
    "V2_uint64_pid_payloadhdr": one(
        DataSetMessage(1, types=(11,), values=(1.0,)), 5, publisher_id_type=PublisherIdType.UINT64
    ),
    "V3_string_pid": one(DataSetMessage(1, types=(6,), values=(42,)), "r-7", publisher_id_type=PublisherIdType.STRING),
    "V5_two_dsm_sizes": NetworkMessage(
        7,
        messages=(DataSetMessage(1, types=(11,), values=(1.0,)), DataSetMessage(2, types=(6,), values=(7,))),
    ),
    "V6_promoted": one(
        DataSetMessage(0, types=(11,), values=(3.0,)),
        promoted_types=(11,),
        promoted_values=(3.0,),
        payload_header=False,
    ),
    "V8_delta": one(
        DataSetMessage(1, FrameKind.DELTA, types=(6, 11), values=(5, 2.5), indices=(1, 3), sequence_number=6)
    ),
    "V10_keepalive_nextseq8": one(DataSetMessage(1, FrameKind.KEEP_ALIVE, sequence_number=8)),
    "V11_datavalue": one(
        DataSetMessage(
            1,
            types=(6,),
            values=(9,),
            encoding=FieldEncoding.DATA_VALUE,
            field_status=(0x4000_0000,),
            field_source_timestamps=(STAMP,),
        )
    ),
    "V9_event": one(DataSetMessage(1, FrameKind.EVENT, types=(12,), values=("ev",), sequence_number=7)),
}


@pytest.mark.parametrize("name", CONFIRMED)
def test_built_by_hand(name: str) -> None:
    data = (built("built_and_confirmed") | built("built_from_tables_unconfirmed"))[name]
    assert decode(data) == CONFIRMED[name]
    assert Codec().encode(CONFIRMED[name]) == data


def test_every_built_vector_has_a_test() -> None:
    others = {"V12_raw", "V13_chunk0", "V14_chunk1", "V15_probe_metadata_w1", "V16_announce_endpoints_empty"}
    secured = {"V19_sign128", "V19_signenc256"}
    names = set(built("built_and_confirmed") | built("built_from_tables_unconfirmed"))
    assert names == set(CONFIRMED) | others | secured


@pytest.mark.parametrize("name", ["V19_sign128", "V19_signenc256"])
def test_secured_vectors(name: str) -> None:
    with pytest.raises(SecuredMessage):
        Codec().decode(built("built_and_confirmed")[name])


@pytest.mark.parametrize(
    ("name", "policy", "mode"),
    [
        ("V19_sign128", SecurityPolicy.AES128_CTR, SecurityMode.SIGN),
        ("V19_signenc256", SecurityPolicy.AES256_CTR, SecurityMode.SIGN_AND_ENCRYPT),
    ],
)
def test_secured_vectors_opened(name: str, policy: SecurityPolicy, mode: SecurityMode) -> None:
    data = built("built_and_confirmed")[name]
    heard = read_security(data)
    assert (heard.mode, heard.token_id, heard.nonce.hex()) == (mode, 1, "a1b2c3d401000000")
    plain = key(policy).unprotect(heard)
    content = peer_message(types=(11,), values=(21.5,))
    assert decode(plain) == content
    assert key(policy).protect(Codec().encode(content), payload_offset(plain), 1, heard.nonce, mode) == data


@pytest.mark.parametrize("name", ["V13_chunk0", "V14_chunk1"])
def test_chunks_have_their_own_cause(name: str) -> None:
    with pytest.raises(RemoteWireError) as caught:
        Codec().decode(built("built_from_tables_unconfirmed")[name])
    assert caught.value.cause == "chunk"


def test_chunk_vectors() -> None:
    parts = [built("built_from_tables_unconfirmed")[name] for name in ("V13_chunk0", "V14_chunk1")]
    first, last = (read_chunk(data) for data in parts)
    assert first is not None
    assert last is not None
    assert (first.publisher_id, first.data_set_writer_id, first.message_sequence_number) == (7, 62541, 3)
    assert [(chunk.offset, chunk.total_size, chunk.data) for chunk in (first, last)] == [
        (0, 8, b"ABCDE"),
        (5, 8, b"FGH"),
    ]
    whole = bytes.fromhex("d1 01 0700 01 4df4") + b"ABCDEFGH"
    assert join(first, first.data, last.data) == join(last, first.data, last.data) == whole
    # So short a message is never split by us, so the TotalSize is that of a longer one.
    chunk = split(whole + b"I" * 12, len(parts[0]), 3)[0]
    assert chunk.replace(b"\x14\0\0\0", b"\x08\0\0\0") == parts[0]


def test_raw_vector() -> None:
    data = built("built_from_tables_unconfirmed")["V12_raw"]
    metadata = DataSetMetaData(
        "raw",
        (FieldMetaData("a", 11), FieldMetaData("b", 7), FieldMetaData("c", 12, max_string_length=8)),
        ConfigurationVersion(1, 1),
    )
    decoded = decode(data)
    assert decode_raw_fields(decoded.messages[0], metadata).values == (1.5, 4, "ab")
    assert Codec().encode(decoded) == data


def test_probe_vector() -> None:
    data = built("built_from_tables_unconfirmed")["V15_probe_metadata_w1"]
    probe = Probe(7, PublisherIdType.UINT16, ProbeKind.DATA_SET_META_DATA, (1,))
    assert Codec().decode(data) == probe
    assert encode_probe(probe) == data


def test_announcement_vector() -> None:
    data = built("built_from_tables_unconfirmed")["V16_announce_endpoints_empty"]
    announcement = EndpointsAnnouncement(7, PublisherIdType.UINT16, 0, ())
    assert Codec().decode(data) == announcement
    assert encode_announcement(announcement) == data
