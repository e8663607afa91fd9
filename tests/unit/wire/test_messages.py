"""NetworkMessages as bytes: one table of (name, message, bytes), run in both directions.

The bytes are worked out from tables 154 to 166 of OPC 10000-14.
"""

from __future__ import annotations

from typing import Any
from uuid import UUID

import pytest

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import DataValue, Variant
from ua_fleet.wire import Codec
from ua_fleet.wire.generic import decode_message, encode_message
from ua_fleet.wire.messages import DataSetMessage, FieldEncoding, FrameKind, NetworkMessage, PublisherIdType

KEY = DataSetMessage(9, types=(3,), values=(7,))
KEY_HEX = "01 0100 03 07"
"""Flags, one field, a Byte."""


def message(part: DataSetMessage = KEY, **header: Any) -> NetworkMessage:
    return NetworkMessage(2, messages=(part,))._replace(**header)


def frame(**fields: Any) -> NetworkMessage:
    return message(KEY._replace(**fields))


TABLE: list[tuple[str, NetworkMessage, str]] = [
    ("no PublisherId", message(publisher_id=None), "41 01 0900" + KEY_HEX),
    ("Byte PublisherId", message(publisher_id=2, publisher_id_type=PublisherIdType.BYTE), "51 02 01 0900" + KEY_HEX),
    ("UInt16 PublisherId", message(), "d1 01 0200 01 0900" + KEY_HEX),
    ("UInt32 PublisherId", message(publisher_id=70_000, publisher_id_type=2), "d1 02 70110100 01 0900" + KEY_HEX),
    ("UInt64 PublisherId", message(publisher_id=5, publisher_id_type=3), "d1 03 0500000000000000 01 0900" + KEY_HEX),
    ("String PublisherId", message(publisher_id="é", publisher_id_type=4), "d1 04 02000000 c3a9 01 0900" + KEY_HEX),
    (
        "DataSetClassId",
        message(data_set_class_id=UUID("72962b91-fa75-4ae6-8d28-b404dc7daf63")),
        "d1 09 0200 912b9672 75fa e64a 8d28b404dc7daf63 01 0900" + KEY_HEX,
    ),
    ("WriterGroupId", message(writer_group_id=3), "f1 01 0200 01 0300 01 0900" + KEY_HEX),
    (
        "all of the group header",
        message(writer_group_id=3, group_version=4, network_message_number=5, sequence_number=6),
        "f1 01 0200 0f 0300 04000000 0500 0600 01 0900" + KEY_HEX,
    ),
    ("group sequence number alone", message(sequence_number=6), "f1 01 0200 08 0600 01 0900" + KEY_HEX),
    ("NetworkMessage timestamp", message(timestamp=1), "d1 21 0200 01 0900 0100000000000000" + KEY_HEX),
    (
        "NetworkMessage timestamp and picoseconds",
        message(timestamp=1, picoseconds=2),
        "d1 61 0200 01 0900 0100000000000000 0200" + KEY_HEX,
    ),
    ("no payload header", message(KEY._replace(data_set_writer_id=0), payload_header=False), "91 01 0200" + KEY_HEX),
    (
        "promoted fields: their size is in bytes",
        message(promoted_types=(3, 12), promoted_values=(1, "a")),
        "d1 81 02 0200 01 0900 0800 03 01 0c 01000000 61" + KEY_HEX,
    ),
    (
        "no promoted fields but their size",
        message(promoted_types=(), promoted_values=()),
        "d1 81 02 0200 01 0900 0000" + KEY_HEX,
    ),
    (
        "three DataSetMessages and their sizes",
        message(messages=(KEY, DataSetMessage(8, kind=FrameKind.KEEP_ALIVE, sequence_number=1), KEY)),
        "d1 01 0200 03 0900 0800 0900 0500 0400 0500" + KEY_HEX + "89 03 0100" + KEY_HEX,
    ),
    ("a frame that is not valid", frame(valid=False, types=(), values=()), "d1 01 0200 01 0900 00"),
    ("sequence number", frame(sequence_number=0xFFFF), "d1 01 0200 01 0900 09 ffff 0100 03 07"),
    ("status: its upper 16 bits", frame(status=0x8031_0000), "d1 01 0200 01 0900 11 3180 0100 03 07"),
    ("major version", frame(major_version=1), "d1 01 0200 01 0900 21 01000000 0100 03 07"),
    ("minor version", frame(minor_version=2), "d1 01 0200 01 0900 41 02000000 0100 03 07"),
    ("timestamp", frame(timestamp=3), "d1 01 0200 01 0900 81 10 0300000000000000 0100 03 07"),
    ("picoseconds", frame(timestamp=3, picoseconds=4), "d1 01 0200 01 0900 81 30 0300000000000000 0400 0100 03 07"),
    (
        "everything in a DataSetMessage header, in this order",
        frame(sequence_number=1, timestamp=2, picoseconds=3, status=4 << 16, major_version=5, minor_version=6),
        "d1 01 0200 01 0900 f9 30 0100 0200000000000000 0300 0400 05000000 06000000 0100 03 07",
    ),
    (
        "several fields",
        frame(types=(1, 12, 0x83), values=(True, "a", (1, 2))),
        "d1 01 0200 01 0900 01 0300 01 01 0c 01000000 61 83 02000000 01 02",
    ),
    ("a heartbeat is a header alone", frame(types=(), values=(), sequence_number=1), "d1 01 0200 01 0900 09 0100"),
    (
        "a Bad field is a StatusCode",
        frame(types=(0x13,), values=(0x8000_0000,)),
        "d1 01 0200 01 0900 01 0100 13 00000080",
    ),
    (
        "an Uncertain field may be a DataValue",
        frame(types=(0x17,), values=(DataValue(Variant(3, 7), 0x4000_0000),)),
        "d1 01 0200 01 0900 01 0100 17 03 03 07 00000040",
    ),
    ("a null field", frame(types=(0,), values=(None,)), "d1 01 0200 01 0900 01 0100 00"),
    ("delta frame", frame(kind=FrameKind.DELTA, indices=(4,)), "d1 01 0200 01 0900 81 01 0100 0400 03 07"),
    (
        "delta frame without fields",
        frame(kind=FrameKind.DELTA, types=(), values=(), indices=()),
        "d1 01 0200 01 0900 81 01 0000",
    ),
    ("event", frame(kind=FrameKind.EVENT), "d1 01 0200 01 0900 81 02 0100 03 07"),
    ("keep-alive", frame(kind=FrameKind.KEEP_ALIVE, types=(), values=()), "d1 01 0200 01 0900 81 03"),
    (
        "keep-alive with versions",
        frame(kind=FrameKind.KEEP_ALIVE, types=(), values=(), sequence_number=1, major_version=2, minor_version=3),
        "d1 01 0200 01 0900 e9 03 0100 02000000 03000000",
    ),
    (
        "DataValue encoding, what stands beside the values",
        frame(
            encoding=FieldEncoding.DATA_VALUE,
            types=(3, 0, 12),
            values=(7, None, "a"),
            field_status=(0, 0x8000_0000, 0),
            field_source_timestamps=(1, None, None),
            field_source_picoseconds=(2, None, None),
            field_server_timestamps=(3, None, None),
            field_server_picoseconds=(4, None, None),
        ),
        "d1 01 0200 01 0900 05 0300 3d 03 07 0100000000000000 0200 0300000000000000 0400 02 00000080 01 0c 01000000 61",
    ),
    (
        "delta frame in DataValue encoding",
        frame(kind=FrameKind.DELTA, indices=(2,), encoding=FieldEncoding.DATA_VALUE, field_status=(0,)),
        "d1 01 0200 01 0900 85 01 0100 0200 01 03 07",
    ),
    (
        "RawData",
        frame(encoding=FieldEncoding.RAW_DATA, types=(), values=(), raw=b"\x07\x00"),
        "d1 01 0200 01 0900 03 07 00",
    ),
]

ALL = pytest.mark.parametrize(("value", "encoded"), [pytest.param(*row[1:], id=row[0]) for row in TABLE])


@ALL
def test_decodes(value: NetworkMessage, encoded: str) -> None:
    assert decode_message(bytes.fromhex(encoded)) == value


@ALL
def test_encodes(value: NetworkMessage, encoded: str) -> None:
    assert encode_message(value) == bytes.fromhex(encoded)


@ALL
def test_the_codec_gives_the_same_each_time(value: NetworkMessage, encoded: str) -> None:
    """The third time a plan may be at work."""
    codec, data = Codec(), bytes.fromhex(encoded)
    for _ in range(4):
        assert codec.decode(data) == value
        assert codec.encode(value) == data


@ALL
def test_zero_padding_is_passed_over(value: NetworkMessage, encoded: str) -> None:
    """A DataSetMessage is padded up to its ConfiguredSize (OPC 10000-14 6.3.1.3.3)."""
    if value.messages[0].encoding == FieldEncoding.RAW_DATA:
        return  # its metadata alone says where padding begins
    assert decode_message(bytes.fromhex(encoded) + bytes(5)) in (value, *_with_no_fields(value))


def _with_no_fields(value: NetworkMessage) -> list[NetworkMessage]:
    """A padded heartbeat and a key frame with the field count 0 are the same bytes, and the same message."""
    return [value._replace(messages=(part._replace(types=(), values=()),)) for part in value.messages[:1]]


def test_header_flags_without_effect_are_accepted() -> None:
    """Extended flags of 0 shall be left out, and a receiver that finds them does no harm."""
    assert decode_message(bytes.fromhex("d1 80 00 02 01 0900" + KEY_HEX)) == message(publisher_id_type=0)
    assert decode_message(bytes.fromhex("d1 01 0200 01 0900 81 00 0100 03 07")) == message()


def test_null_publisher_id_of_type_string_is_empty() -> None:
    decoded = decode_message(bytes.fromhex("d1 04 ffffffff 01 0900" + KEY_HEX))
    assert decoded.publisher_id == ""


def test_sizes_bound_each_message() -> None:
    with pytest.raises(RemoteWireError, match="trailing_bytes"):
        decode_message(bytes.fromhex("d1 01 0200 02 0900 0800 0600 0400" + KEY_HEX + "99" + KEY_HEX))
    with pytest.raises(RemoteWireError, match="truncated"):
        decode_message(bytes.fromhex("d1 01 0200 02 0900 0800 0400 0500" + KEY_HEX + KEY_HEX))


LOCAL_MISTAKES: list[tuple[str, NetworkMessage]] = [
    ("PublisherId out of range", message(publisher_id=70_000)),
    ("PublisherId of another type", message(publisher_id="2")),
    ("PublisherId is no String", message(publisher_id=2, publisher_id_type=4)),
    ("reserved PublisherId type", message(publisher_id_type=5)),
    ("WriterGroupId", message(writer_group_id=70_000)),
    ("DataSetClassId", message(data_set_class_id=5)),
    ("no DataSetMessage", message(messages=())),
    ("too many DataSetMessages", message(messages=(KEY,) * 256)),
    ("two without a payload header", message(messages=(KEY, KEY), payload_header=False)),
    ("none without a payload header", message(messages=(), payload_header=False)),
    ("DataSetWriterId", message(KEY._replace(data_set_writer_id=70_000))),
    ("promoted fields of two messages", message(messages=(KEY, KEY), promoted_types=(3,), promoted_values=(1,))),
    ("promoted types without values", message(promoted_types=(3,), promoted_values=())),
    (
        "a message that is too long for its size",
        message(messages=(KEY, frame(types=(12,), values=("x" * 70_000,)).messages[0])),
    ),
    ("types without values", frame(values=())),
    ("values without types", frame(types=())),
    ("reserved kind", frame(kind=4)),
    ("reserved encoding", frame(encoding=3)),
    ("keep-alive with fields", frame(kind=FrameKind.KEEP_ALIVE)),
    ("event in DataValue encoding", frame(kind=FrameKind.EVENT, encoding=FieldEncoding.DATA_VALUE)),
    ("delta without indices", frame(kind=FrameKind.DELTA)),
    ("delta with an index used twice", frame(kind=FrameKind.DELTA, types=(3, 3), values=(1, 2), indices=(1, 1))),
    ("key frame with indices", frame(indices=(1,))),
    ("RawData without bytes", frame(encoding=FieldEncoding.RAW_DATA)),
    ("too few statuses", frame(encoding=FieldEncoding.DATA_VALUE, field_status=())),
    ("too many fields", frame(types=(0,) * 65_536, values=(None,) * 65_536)),
    ("sequence number", frame(sequence_number=65_536)),
    ("status", frame(status=-1)),
    ("not a number", frame(sequence_number="1")),
    ("not a message", message("text")),  # type: ignore[arg-type]
    ("no messages at all", message(messages=None)),
]


@pytest.mark.parametrize("value", [pytest.param(row[1], id=row[0]) for row in LOCAL_MISTAKES])
def test_what_cannot_be_encoded_is_our_mistake(value: NetworkMessage) -> None:
    with pytest.raises(LocalWireError):
        encode_message(value)
    with pytest.raises(LocalWireError):
        Codec().encode(value)
