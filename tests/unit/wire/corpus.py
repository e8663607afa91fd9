"""Valid messages of every kind, and what may happen to them on the way: the ground of the fuzz and plan tests."""

from __future__ import annotations

import random
import struct
from pathlib import Path
from uuid import UUID

from ua_fleet.values import (
    DataValue,
    DiagnosticInfo,
    ExpandedNodeId,
    ExtensionObject,
    LocalizedText,
    Matrix,
    NodeId,
    QualifiedName,
    Variant,
)
from ua_fleet.wire import Codec, encode_metadata_announcement, encode_probe
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldEncoding,
    FieldMetaData,
    FrameKind,
    MetaDataAnnouncement,
    NetworkMessage,
    Probe,
    ProbeKind,
    PublisherIdType,
)

VECTORS = Path(__file__).parents[2] / "vectors"
GUID = UUID("72962b91-fa75-4ae6-8d28-b404dc7daf63")

EVERY_TYPE: tuple[Variant, ...] = (
    Variant(0, None),
    Variant(1, True),
    Variant(2, -2),
    Variant(3, 3),
    Variant(4, -4),
    Variant(5, 5),
    Variant(6, -6),
    Variant(7, 7),
    Variant(8, -8),
    Variant(9, 9),
    Variant(10, 0.5),
    Variant(11, -0.5),
    Variant(12, "水Boy"),
    Variant(13, 133_500_000_000_000_000),
    Variant(14, GUID),
    Variant(15, b"\0\xff"),
    Variant(16, "<a/>"),
    Variant(17, NodeId(2, "robot")),
    Variant(18, ExpandedNodeId(NodeId(2, GUID), "urn:a", 1)),
    Variant(19, 0x8031_0000),
    Variant(20, QualifiedName(2, "RosType")),
    Variant(21, LocalizedText("text", "en")),
    Variant(22, ExtensionObject(NodeId(2, 70_000), b"body")),
    Variant(23, DataValue(Variant(12, "x"), 0x4000_0000, 1, 2, 3, 4)),
    Variant(25, DiagnosticInfo(1, 2, 3, 4, "info", 5, DiagnosticInfo(6))),
    Variant(0x8B, (1.0, 2.0, 3.0)),
    Variant(0x8C, ("a", None, "bc")),
    Variant(0x98, (Variant(3, 1), Variant(0x8C, ("x",)))),
    Variant(0xC6, Matrix((1, 2, 3, 4, 5, 6), (2, 3))),
    Variant(0xD7, Matrix((DataValue(Variant(1, True)), DataValue(None)), (1, 2))),
)

MINIMAL_METADATA = DataSetMetaData("n", (FieldMetaData("x", 11),), ConfigurationVersion(1, 2))
FULL_METADATA = DataSetMetaData(
    "ua_2_2_1001",
    (
        FieldMetaData(
            "linear.x",
            11,
            description=LocalizedText("speed", "en"),
            field_flags=1,
            data_type=NodeId(2, "Speed"),
            value_rank=1,
            array_dimensions=(3,),
            max_string_length=7,
            data_set_field_id=UUID(int=5),
            properties=(
                (QualifiedName(2, "RosType"), 12, "geometry_msgs/Twist"),
                (QualifiedName(0, "Ids"), 0x85, (1, 2)),
            ),
        ),
        FieldMetaData("name", 12),
    ),
    ConfigurationVersion(800_000_000, 800_000_001),
    description=LocalizedText("a DataSet"),
    data_set_class_id=UUID(int=9),
    namespaces=("urn:a", "urn:b"),
)
RAW_METADATA = DataSetMetaData(
    "raw",
    (
        FieldMetaData("a", 11),
        FieldMetaData("b", 12, max_string_length=8),
        FieldMetaData("c", 5, value_rank=1, array_dimensions=(3,)),
        FieldMetaData("d", 3, value_rank=2, array_dimensions=(2, 2)),
    ),
    ConfigurationVersion(1, 1),
)
RAW_BYTES = bytes.fromhex(
    "000000000000f83f 02000000 6162 000000000000 02000000 0100 0200 0000 02000000 02000000 01000000 0100 0200"
)


def _messages() -> list[NetworkMessage]:
    types = tuple(value.type for value in EVERY_TYPE)
    values = tuple(value.value for value in EVERY_TYPE)
    header = DataSetMessage(1001, sequence_number=7, timestamp=133_500_000_000_000_000, status=0)
    ours = header._replace(major_version=8, minor_version=9)
    raw = DataSetMessage(5, encoding=FieldEncoding.RAW_DATA, raw=RAW_BYTES)
    parts: list[DataSetMessage] = [
        ours._replace(types=(11,), values=(1.5,)),
        ours._replace(types=(12,), values=("text",)),
        ours._replace(types=(0x8B, 12, 6), values=((1.0, 2.0), "map", 3)),
        ours._replace(types=(11,) * 50, values=tuple(float(i) for i in range(50))),
        ours._replace(types=types, values=values),
        ours._replace(kind=FrameKind.KEEP_ALIVE.value),
        header._replace(kind=FrameKind.EVENT.value, types=types[:14], values=values[:14]),
        header._replace(kind=FrameKind.DELTA.value, types=types[9:13], values=values[9:13], indices=(4, 3, 2, 1)),
        header._replace(encoding=FieldEncoding.DATA_VALUE.value, types=types, values=values),
        header._replace(types=(), values=()),
        raw,
        raw._replace(kind=FrameKind.DELTA.value, raw=bytes.fromhex("0100 0200 02000000 0100 0200 0000")),
    ]
    messages = [NetworkMessage(2, writer_group_id=2, messages=(part,)) for part in parts]
    key = DataSetMessage(3, types=(11, 12), values=(1.5, "a"))
    return [
        *messages,
        NetworkMessage(2, writer_group_id=2, messages=(parts[0], parts[5], parts[2], DataSetMessage(4, valid=False))),
        NetworkMessage("robot-é", PublisherIdType.STRING, messages=(key,)),
        NetworkMessage(7, PublisherIdType.BYTE, messages=(key,), payload_header=False),
        NetworkMessage(1 << 60, PublisherIdType.UINT64, messages=(key._replace(sequence_number=1),)),
        NetworkMessage(
            1 << 20,
            PublisherIdType.UINT32,
            data_set_class_id=GUID,
            writer_group_id=1,
            group_version=2,
            network_message_number=3,
            sequence_number=4,
            timestamp=5,
            picoseconds=6,
            promoted_types=(11, 12),
            promoted_values=(1.5, "a"),
            messages=(key._replace(timestamp=1, picoseconds=2),),
        ),
    ]


def valid_messages() -> list[bytes]:
    """Our own messages of every kind, and the recorded ones."""
    codec = Codec()
    recorded = [
        bytes.fromhex(word)
        for path in sorted([*VECTORS.glob("*.hex"), *VECTORS.glob("*.tsv")])
        for word in [line.split()[-1] for line in path.read_text(encoding="ascii").splitlines()][:2]
    ]
    return [
        *[codec.encode(message) for message in _messages()],
        encode_metadata_announcement(MetaDataAnnouncement(2, PublisherIdType.UINT16, 1, 1001, FULL_METADATA)),
        encode_probe(Probe(2, PublisherIdType.UINT16, ProbeKind.DATA_SET_META_DATA, (1, 2))),
        *recorded,
    ]


LENGTHS = (-2, -1, 0, 1, 2, 3, 16, 255, 256, 65_535, 65_536, 0x7FFF_FFFF, -0x8000_0000)
INTERESTING_BYTES = (0, 1, 2, 3, 0x10, 0x40, 0x7F, 0x80, 0x81, 0xC6, 0xFE, 0xFF)


def mutate(chance: random.Random, corpus: list[bytes]) -> bytes:
    """One of the corpus with one to three things gone wrong."""
    data = bytearray(chance.choice(corpus))
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        if not data:
            break
        at = int(chance.random() * len(data))
        what = int(chance.random() * 8)
        if what <= 1:
            data[at] ^= 1 << int(chance.random() * 8)
        elif what == 2:
            data[at] = chance.choice(INTERESTING_BYTES)
        elif what == 3:
            data[at : at + 4] = struct.pack("<i", chance.choice(LENGTHS))
        elif what == 4:
            del data[at:]
        elif what == 5:
            del data[at : at + 1 + int(chance.random() * 8)]
        elif what == 6:
            data[at:at] = chance.randbytes(1 + int(chance.random() * 8))
        else:
            other = chance.choice(corpus)
            data[at:] = other[int(chance.random() * len(other)) :]
    return bytes(data)
