# pyright: reportUnknownVariableType=false
"""asyncua's codec as a second opinion: plain Variant and DataValue messages, and metadata."""

from __future__ import annotations

from typing import Any
from uuid import UUID

import pytest
from asyncua import ua as asyncua_ua
from asyncua.common.utils import Buffer
from asyncua.pubsub import uadp as asyncua_uadp
from asyncua.ua.ua_binary import struct_from_binary, struct_to_binary

from tests.unit.wire.corpus import FULL_METADATA as FULL
from tests.unit.wire.corpus import MINIMAL_METADATA as MINIMAL
from ua_fleet.values import LocalizedText, NodeId, QualifiedName, datetime_from_ticks
from ua_fleet.wire import Codec
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.descriptions import (
    EnumerationDescription,
    EnumerationField,
    SimpleTypeDescription,
    StructureDescription,
    StructureField,
)
from ua_fleet.wire.messages import DataSetMessage, FieldEncoding, NetworkMessage
from ua_fleet.wire.metadata import decode_metadata, encode_metadata

# Its types would have every number wrapped in a class of its own.
ua: Any = asyncua_ua
uadp: Any = asyncua_uadp

STAMP = 133_500_000_000_000_000
GUID = UUID("72962b91-fa75-4ae6-8d28-b404dc7daf63")

VALUES: list[tuple[int, Any, Any]] = [
    (1, True, True),
    (2, -2, -2),
    (3, 3, 3),
    (4, -4, -4),
    (5, 5, 5),
    (6, -6, -6),
    (7, 7, 7),
    (8, -8, -8),
    (9, 9, 9),
    (10, 0.5, 0.5),
    (11, -6.5, -6.5),
    (12, "水Boy", "水Boy"),
    (13, STAMP, datetime_from_ticks(STAMP)),
    (14, GUID, GUID),
    (15, b"ab", b"ab"),
    (0x86, (1, 2), [1, 2]),
    (0x8C, ("a", "b"), ["a", "b"]),
]
PART = DataSetMessage(
    1001,
    types=tuple(code for code, _, _ in VALUES),
    values=tuple(value for _, value, _ in VALUES),
    sequence_number=7,
    timestamp=STAMP,
    status=0x8031_0000,
    major_version=8,
    minor_version=9,
)


def read_by_asyncua(part: DataSetMessage) -> Any:
    data = Codec().encode(NetworkMessage(2, writer_group_id=3, messages=(part,)))
    message = uadp.UadpNetworkMessage.from_binary(Buffer(data))
    assert (message.Header.PublisherId, message.GroupHeader.WriterGroupId) == (2, 3)
    assert message.DataSetPayloadHeader == [1001]
    return message


@pytest.mark.parametrize("encoding", [FieldEncoding.VARIANT, FieldEncoding.DATA_VALUE])
def test_data_is_what_asyncua_reads(encoding: FieldEncoding) -> None:
    theirs = read_by_asyncua(PART._replace(encoding=encoding)).Payload[0]
    header = theirs.Header
    assert (header.SequenceNo, header.Status) == (7, 0x8031)
    assert (header.CfgMajorVersion, header.CfgMinorVersion) == (8, 9)
    assert header.Timestamp.replace(tzinfo=None) == datetime_from_ticks(STAMP).replace(tzinfo=None)
    values = [field if encoding is FieldEncoding.VARIANT else field.Value for field in theirs.Data]
    assert [value.VariantType.value for value in values] == [code & 0x3F for code, _, _ in VALUES]
    assert [value.Value for value in values] == [expected for _, _, expected in VALUES]


@pytest.mark.parametrize("encoding", [FieldEncoding.VARIANT, FieldEncoding.DATA_VALUE])
def test_what_asyncua_writes_is_read(encoding: FieldEncoding) -> None:
    part = PART._replace(encoding=encoding)
    ours = Codec().decode(read_by_asyncua(part).to_binary())
    assert isinstance(ours, NetworkMessage)
    assert (ours.messages[0].types, ours.messages[0].values) == (PART.types, PART.values)
    assert ours.messages[0].timestamp == STAMP


def test_metadata_is_what_asyncua_reads() -> None:
    out = bytearray()
    encode_metadata(out, FULL)
    theirs = struct_from_binary(ua.DataSetMetaDataType, Buffer(bytes(out)))
    assert theirs.Name == FULL.name
    assert theirs.Namespaces == list(FULL.namespaces)
    assert theirs.Description.Text == "a DataSet"
    assert theirs.DataSetClassId == UUID(int=9)
    assert (theirs.ConfigurationVersion.MajorVersion, theirs.ConfigurationVersion.MinorVersion) == (
        FULL.configuration_version
    )
    speed, name = theirs.Fields
    assert (speed.Name, speed.Description.Text, speed.Description.Locale) == ("linear.x", "speed", "en")
    assert (speed.FieldFlags, speed.BuiltInType, speed.ValueRank) == (1, 11, 1)
    assert (speed.DataType.NamespaceIndex, speed.DataType.Identifier) == (2, "Speed")
    assert (speed.ArrayDimensions, speed.MaxStringLength, speed.DataSetFieldId) == ([3], 7, UUID(int=5))
    assert [(pair.Key.Name, pair.Value.Value) for pair in speed.Properties] == [
        ("RosType", "geometry_msgs/Twist"),
        ("Ids", [1, 2]),
    ]
    assert (name.DataType.Identifier, name.ValueRank) == (12, -1)


def test_descriptions_of_types_are_those_of_asyncua() -> None:
    """Structures, enumerations and simple types: asyncua's bytes are read, and written again as they were."""
    structure = ua.StructureDescription(
        DataTypeId=ua.NodeId(1, 2),
        Name=ua.QualifiedName("S", 2),
        StructureDefinition=ua.StructureDefinition(
            DefaultEncodingId=ua.NodeId(3, 2),
            BaseDataType=ua.NodeId(22),
            StructureType=ua.StructureType.StructureWithOptionalFields,
            Fields=[
                ua.StructureField(Name="a", DataType=ua.NodeId(11), ValueRank=1, ArrayDimensions=[3], IsOptional=True),
                ua.StructureField(
                    Name="b", Description=ua.LocalizedText("d", "en"), DataType=ua.NodeId("t", 2), IsOptional=False
                ),
            ],
        ),
    )
    enumeration = ua.EnumDescription(
        DataTypeId=ua.NodeId(4, 2),
        Name=ua.QualifiedName("E", 2),
        EnumDefinition=ua.EnumDefinition(
            Fields=[ua.EnumField(Value=1, DisplayName=ua.LocalizedText("one"), Name="One")]
        ),
        BuiltInType=6,
    )
    simple = ua.SimpleTypeDescription(
        DataTypeId=ua.NodeId(5, 2), Name=ua.QualifiedName("T", 2), BaseDataType=ua.NodeId(11), BuiltInType=11
    )
    theirs = ua.DataSetMetaDataType(
        Namespaces=["urn:a"],
        StructureDataTypes=[structure],
        EnumDataTypes=[enumeration],
        SimpleDataTypes=[simple],
        Name="n",
        Fields=[ua.FieldMetaData(Name="x", BuiltInType=11, DataType=ua.NodeId(11), ValueRank=-1)],
        ConfigurationVersion=ua.ConfigurationVersionDataType(MajorVersion=1, MinorVersion=2),
    )
    data = struct_to_binary(theirs)
    cursor = Cursor(data)
    metadata = decode_metadata(cursor)
    assert cursor.remaining == 0
    members = (
        StructureField("a", NodeId(0, 11), 1, is_optional=True, array_dimensions=(3,)),
        StructureField("b", NodeId(2, "t"), 0, description=LocalizedText("d", "en")),
    )
    assert metadata == MINIMAL._replace(
        namespaces=("urn:a",),
        structures=(StructureDescription(NodeId(2, 1), QualifiedName(2, "S"), members, 1, NodeId(2, 3)),),
        enumerations=(
            EnumerationDescription(
                NodeId(2, 4), QualifiedName(2, "E"), (EnumerationField(1, "One", LocalizedText("one")),)
            ),
        ),
        simple_types=(SimpleTypeDescription(NodeId(2, 5), QualifiedName(2, "T"), NodeId(0, 11), 11),),
    )
    out = bytearray()
    encode_metadata(out, metadata)
    assert bytes(out) == data
