"""The structures of discovery as JSON objects (OPC 10000-14 6.2 and 6.3, OPC 10000-4 7): tables of their members.

The numbers are those of the DataTypes in namespace 0 (OPC 10000-6 annex A); JSON names DataTypes, not their encodings.
"""

from __future__ import annotations

from typing import Final

from ua_fleet.wire import discovered as d
from ua_fleet.wire.json.metadata import META_DATA, PROPERTIES
from ua_fleet.wire.json.records import (
    BOOLEAN,
    BYTE,
    BYTE_STRING,
    DOUBLE,
    ENUMERATION,
    LOCALIZED_TEXT,
    NODE_ID,
    STRING,
    TEXT,
    UINT16,
    UINT32,
    VARIANT,
    Member,
    array,
    extension,
    nested,
    record,
)

__all__ = [
    "ACTION_METHOD",
    "ACTION_TARGET",
    "APPLICATION_DESCRIPTION",
    "CONNECTION",
    "ENDPOINT_DESCRIPTION",
]

APPLICATION_DESCRIPTION: Final = record(
    d.ApplicationDescription,
    ApplicationUri=STRING,
    ProductUri=STRING,
    ApplicationName=LOCALIZED_TEXT,
    ApplicationType=ENUMERATION,
    GatewayServerUri=STRING,
    DiscoveryProfileUri=STRING,
    DiscoveryUrls=array(TEXT),
)

USER_TOKEN_POLICY: Final = record(
    d.UserTokenPolicy,
    PolicyId=STRING,
    TokenType=ENUMERATION,
    IssuedTokenType=STRING,
    IssuerEndpointUrl=STRING,
    SecurityPolicyUri=STRING,
)

ENDPOINT_DESCRIPTION: Final = record(
    d.EndpointDescription,
    EndpointUrl=STRING,
    Server=nested(APPLICATION_DESCRIPTION),
    ServerCertificate=BYTE_STRING,
    SecurityMode=ENUMERATION,
    SecurityPolicyUri=STRING,
    UserIdentityTokens=array(USER_TOKEN_POLICY),
    TransportProfileUri=STRING,
    SecurityLevel=BYTE,
)

NETWORK_ADDRESS_URL: Final = record(d.NetworkAddressUrl, NetworkInterface=STRING, Url=STRING)
ADDRESS: Final = extension({15510: NETWORK_ADDRESS_URL})

DATAGRAM_TRANSPORT: Final = record(
    d.DatagramConnectionTransport,
    DiscoveryAddress=ADDRESS,
    DiscoveryAnnounceRate=UINT32,
    DiscoveryMaxMessageSize=UINT32,
    QosCategory=STRING,
    DatagramQos=array(extension()),
)

WRITER_MESSAGE: Final = record(
    d.UadpDataSetWriterMessage,
    DataSetMessageContentMask=UINT32,
    ConfiguredSize=UINT16,
    NetworkMessageNumber=UINT16,
    DataSetOffset=UINT16,
)

GROUP_MESSAGE: Final = record(
    d.UadpWriterGroupMessage,
    GroupVersion=UINT32,
    DataSetOrdering=ENUMERATION,
    NetworkMessageContentMask=UINT32,
    SamplingOffset=DOUBLE,
    PublishingOffset=array(DOUBLE),
)

JSON_WRITER_MESSAGE: Final = record(d.JsonDataSetWriterMessage, DataSetMessageContentMask=UINT32)

JSON_GROUP_MESSAGE: Final = record(d.JsonWriterGroupMessage, NetworkMessageContentMask=UINT32)

DATA_SET_WRITER: Final = record(
    d.DataSetWriter,
    Name=STRING,
    Enabled=BOOLEAN,
    DataSetWriterId=UINT16,
    DataSetFieldContentMask=UINT32,
    KeyFrameCount=UINT32,
    DataSetName=STRING,
    DataSetWriterProperties=PROPERTIES,
    TransportSettings=extension(),
    MessageSettings=extension({15652: WRITER_MESSAGE, 15664: JSON_WRITER_MESSAGE}),
)

_GROUP: Final[dict[str, Member]] = {
    "Name": STRING,
    "Enabled": BOOLEAN,
    "SecurityMode": ENUMERATION,
    "SecurityGroupId": STRING,
    "SecurityKeyServices": array(ENDPOINT_DESCRIPTION),
    "MaxNetworkMessageSize": UINT32,
    "GroupProperties": PROPERTIES,
}
"""PubSubGroupDataType, from which both kinds of groups inherit."""

WRITER_GROUP: Final = record(
    d.WriterGroup,
    **_GROUP,
    WriterGroupId=UINT16,
    PublishingInterval=DOUBLE,
    KeepAliveTime=DOUBLE,
    Priority=BYTE,
    LocaleIds=array(TEXT),
    HeaderLayoutUri=STRING,
    TransportSettings=extension(),
    MessageSettings=extension({15645: GROUP_MESSAGE, 15657: JSON_GROUP_MESSAGE}),
    DataSetWriters=array(DATA_SET_WRITER),
)

DATA_SET_READER: Final = record(
    d.DataSetReader,
    Name=STRING,
    Enabled=BOOLEAN,
    PublisherId=VARIANT,
    WriterGroupId=UINT16,
    DataSetWriterId=UINT16,
    DataSetMetaData=META_DATA,
    DataSetFieldContentMask=UINT32,
    MessageReceiveTimeout=DOUBLE,
    KeyFrameCount=UINT32,
    HeaderLayoutUri=STRING,
    SecurityMode=ENUMERATION,
    SecurityGroupId=STRING,
    SecurityKeyServices=array(ENDPOINT_DESCRIPTION),
    DataSetReaderProperties=PROPERTIES,
    TransportSettings=extension(),
    MessageSettings=extension(),
    SubscribedDataSet=extension(),
)

READER_GROUP: Final = record(
    d.ReaderGroup,
    **_GROUP,
    TransportSettings=extension(),
    MessageSettings=extension(),
    DataSetReaders=array(DATA_SET_READER),
)

CONNECTION: Final = record(
    d.PubSubConnection,
    Name=STRING,
    Enabled=BOOLEAN,
    PublisherId=VARIANT,
    TransportProfileUri=STRING,
    Address=ADDRESS,
    ConnectionProperties=PROPERTIES,
    TransportSettings=extension({23612: DATAGRAM_TRANSPORT}),
    WriterGroups=array(WRITER_GROUP),
    ReaderGroups=array(READER_GROUP),
)

ACTION_TARGET: Final = record(d.ActionTarget, ActionTargetId=UINT16, Name=STRING, Description=LOCALIZED_TEXT)

ACTION_METHOD: Final = record(d.ActionMethod, ObjectId=NODE_ID, MethodId=NODE_ID)
