"""A metadata with fields of every kind, messages of it, and structures with their descriptions."""

from __future__ import annotations

from typing import Any
from uuid import UUID

from ua_fleet.values import (
    ExpandedNodeId,
    ExtensionObject,
    LocalizedText,
    Matrix,
    NodeId,
    QualifiedName,
    Variant,
)
from ua_fleet.wire.descriptions import (
    EnumerationDescription,
    EnumerationField,
    SimpleTypeDescription,
    StructureDescription,
    StructureField,
    StructureType,
)
from ua_fleet.wire.json import DataSetFields, JsonData, Source
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldMetaData,
    NetworkMessage,
    PublisherIdType,
)

NOON = 133_500_000_000_000_000
GUID = UUID("72962b91-fa75-4ae6-8d28-b404dc7daf63")

COLOUR = EnumerationDescription(
    NodeId(1, 3001), QualifiedName(1, "Colour"), (EnumerationField(0, "Red"), EnumerationField(1, "Deep_Green"))
)
SPEED = SimpleTypeDescription(NodeId(1, 3002), QualifiedName(1, "Speed"), NodeId(0, 11), 11)
POINT = StructureDescription(
    NodeId(1, 3003),
    QualifiedName(1, "Point"),
    (StructureField("X", NodeId(1, 3002)), StructureField("Y", NodeId(0, 8)), StructureField("Name", NodeId(0, 12))),
    default_encoding=NodeId(1, 5003),
)
PATH = StructureDescription(
    NodeId(1, 3004),
    QualifiedName(1, "Path"),
    (
        StructureField("Points", NodeId(1, 3003), 1),
        StructureField("Colour", NodeId(1, 3001)),
        StructureField("Grid", NodeId(0, 6), 2),
        StructureField("Any", NodeId(0, 24)),
    ),
    default_encoding=NodeId(1, 5004),
)
OPTIONAL = StructureDescription(
    NodeId(1, 3005),
    QualifiedName(1, "TypeA"),
    (
        StructureField("X", NodeId(0, 6)),
        StructureField("O1", NodeId(0, 6), is_optional=True),
        StructureField("Y", NodeId(0, 2)),
        StructureField("O2", NodeId(0, 6), is_optional=True),
    ),
    StructureType.WITH_OPTIONAL_FIELDS,
    NodeId(1, 5005),
)
UNION = StructureDescription(
    NodeId(1, 3006),
    QualifiedName(1, "Union1"),
    (StructureField("A", NodeId(0, 6)), StructureField("B", NodeId(0, 11)), StructureField("C", NodeId(0, 12))),
    StructureType.UNION,
    NodeId(1, 5006),
)

FIELDS: list[tuple[FieldMetaData, int, Any]] = [
    (FieldMetaData("Active", 1), 1, True),
    (FieldMetaData("SByte", 2), 2, -2),
    (FieldMetaData("Byte", 3), 3, 3),
    (FieldMetaData("Int16", 4), 4, -4),
    (FieldMetaData("UInt16", 5), 5, 5),
    (FieldMetaData("Int32", 6), 6, -6),
    (FieldMetaData("UInt32", 7), 7, 7),
    (FieldMetaData("Int64", 8), 8, -(2**63)),
    (FieldMetaData("UInt64", 9), 9, 2**64 - 1),
    (FieldMetaData("Float", 10), 10, 0.5),
    (FieldMetaData("Double", 11), 11, -0.1),
    (FieldMetaData("String", 12), 12, "水Boy"),
    (FieldMetaData("DateTime", 13), 13, NOON + 1),
    (FieldMetaData("Guid", 14), 14, GUID),
    (FieldMetaData("ByteString", 15), 15, b"\0\xff"),
    (FieldMetaData("XmlElement", 16), 16, "<a/>"),
    (FieldMetaData("NodeId", 17), 17, NodeId(1, "robot")),
    (FieldMetaData("ExpandedNodeId", 18), 18, ExpandedNodeId(NodeId(0, 7), "urn:other", 1)),
    (FieldMetaData("StatusCode", 19), 19, 0x8031_0000),
    (FieldMetaData("QualifiedName", 20), 20, QualifiedName(1, "RosType")),
    (FieldMetaData("LocalizedText", 21), 21, LocalizedText("text", "en")),
    (FieldMetaData("Any", 24), 0x8C, ("a", None)),
    (FieldMetaData("AnyRank", 6, value_rank=-2), 0xC6, Matrix((1, 2, 3, 4), (2, 2))),
    (FieldMetaData("Doubles", 11, value_rank=1), 0x8B, (1.5, 2.5)),
    (FieldMetaData("Empty", 11, value_rank=1), 0x8B, ()),
    (FieldMetaData("Texts", 12, value_rank=1), 0x8C, ("a", None, "bc")),
    (FieldMetaData("Grid", 6, value_rank=2), 0xC6, Matrix((1, 2, 3, 4, 5, 6), (2, 3))),
    (FieldMetaData("Colour", 6, data_type=NodeId(1, 3001)), 6, 1),
    (FieldMetaData("Colours", 6, data_type=NodeId(1, 3001), value_rank=1), 0x86, (0, 1, 7)),
    (FieldMetaData("Speed", 11, data_type=NodeId(1, 3002)), 11, 2.5),
    (
        FieldMetaData("Opaque", 22, data_type=NodeId(1, 9999)),
        22,
        ExtensionObject(NodeId(1, 70_000), b"body"),
    ),
    (FieldMetaData("Variants", 24, value_rank=1), 0x98, (Variant(3, 1), Variant(0x8C, ("x",)))),
    (FieldMetaData("Nothing", 11), 0, None),
    (FieldMetaData("Failed", 11), 19, 0x8031_0000),
]

VERSION = ConfigurationVersion(800_000_000, 800_000_001)
METADATA = DataSetMetaData(
    "everything",
    tuple([field for field, _, _ in FIELDS]),
    VERSION,
    namespaces=("urn:fleet", "urn:types"),
    structures=(POINT, PATH, OPTIONAL, UNION),
    enumerations=(COLOUR,),
    simple_types=(SPEED,),
)
EVERYTHING = DataSetFields(METADATA)
TYPES = tuple([code for _, code, _ in FIELDS])
VALUES = tuple([value for _, _, value in FIELDS])

SOURCE = Source("2", "group", 1001, "writer")
KEY = DataSetMessage(
    1001,
    types=TYPES,
    values=VALUES,
    sequence_number=70_000,
    timestamp=NOON + 1,
    status=0x4000_0000,
    major_version=VERSION.major,
    minor_version=VERSION.minor,
)


def data(*messages: DataSetMessage, source: Source = SOURCE, message_id: str | None = "m-1") -> JsonData:
    """A NetworkMessage as it is decoded from the layout with all headers."""
    return JsonData(
        NetworkMessage(source.publisher_id, PublisherIdType.STRING, messages=messages),
        (source,) * len(messages),
        message_id,
        source.writer_group_name,
    )
