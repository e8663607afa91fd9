"""An announcement of every kind, with every structure that one may have."""

from __future__ import annotations

from tests.unit.wire.corpus import FULL_METADATA, MINIMAL_METADATA
from ua_fleet.values import BuiltinType, ExtensionObject, LocalizedText, NodeId, QualifiedName, Variant
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    ActionMethod,
    ActionResponderAnnouncement,
    ActionTarget,
    AnyAnnouncement,
    ApplicationAnnouncement,
    ApplicationDescription,
    ApplicationType,
    ConnectionsAnnouncement,
    DatagramConnectionTransport,
    DataSetReader,
    DataSetWriter,
    EndpointDescription,
    EndpointsAnnouncement,
    KeyValuePair,
    NetworkAddressUrl,
    PubSubConnection,
    PubSubState,
    ReaderGroup,
    StatusAnnouncement,
    UadpDataSetWriterMessage,
    UadpWriterGroupMessage,
    UserTokenPolicy,
    WriterConfigurationAnnouncement,
    WriterGroup,
)
from ua_fleet.wire.messages import Announcement, PublisherIdType

U16 = PublisherIdType.UINT16
HEADER = (7, U16, 3)
TIME = 133_500_000_000_000_000

APPLICATION = ApplicationDescription(
    "urn:cell", "urn:ua-fleet", LocalizedText("cell", "en"), ApplicationType.CLIENT, None, "", ("opc.tcp://a", "b")
)
ENDPOINT = EndpointDescription(
    "opc.tcp://host:4840",
    APPLICATION,
    b"\1\2\3",
    3,
    "http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256",
    (UserTokenPolicy("0", 1, None, "url", "policy"), UserTokenPolicy(None, 0)),
    "http://opcfoundation.org/UA-Profile/Transport/uatcp-uasc-uabinary",
    200,
)
VENDOR_SETTINGS = ExtensionObject(NodeId(5, 77), b"\xaa\xbb")
PROPERTY = KeyValuePair(QualifiedName(1, "key"), Variant(BuiltinType.DOUBLE, 1.5))
WRITER = DataSetWriter(
    "pose", True, 1001, 0x20, 1, "pose", (PROPERTY,), VENDOR_SETTINGS, UadpDataSetWriterMessage(0x3F, 1, 2, 3)
)
GROUP = WriterGroup(
    "fleet",
    True,
    3,
    "t-2",
    (ENDPOINT,),
    65_507,
    (PROPERTY,),
    2,
    0.5,
    1000.0,
    9,
    ("en", "de"),
    "http://opcfoundation.org/UA/PubSub-Layouts/UADP-Dynamic",
    None,
    UadpWriterGroupMessage(7, 1, 0x7F, 0.25, (1.0, 2.0)),
    (WRITER, DataSetWriter(None, False, 1)),
)
READER = DataSetReader(
    "reader", True, Variant(BuiltinType.UINT16, 3), 2, 1001, FULL_METADATA, 0x20, 3000.0, 1, None, 2, "t-3", (ENDPOINT,)
)
CONNECTION_OF_ALL = PubSubConnection(
    "udp",
    True,
    Variant(BuiltinType.UINT16, 2),
    "http://opcfoundation.org/UA-Profile/Transport/pubsub-udp-uadp",
    NetworkAddressUrl("lo", "opc.udp://224.0.2.14:4840"),
    (PROPERTY,),
    DatagramConnectionTransport(NetworkAddressUrl(None, "opc.udp://a"), 60, 65_507, None, (VENDOR_SETTINGS,)),
    (GROUP,),
    (ReaderGroup("in", True, data_set_readers=(READER,)),),
)
PLAIN_CONNECTION = PubSubConnection(None, False, Variant(BuiltinType.STRING, "a"), None, VENDOR_SETTINGS)
TARGET = ActionTarget(3, "gripper", LocalizedText("the gripper"))
METHOD = ActionMethod(NodeId(2, "robot"), NodeId(2, 9))

ANNOUNCEMENTS: dict[str, AnyAnnouncement] = {
    "endpoints": EndpointsAnnouncement(*HEADER, (ENDPOINT, ENDPOINT), 0x4000_0000),
    "no endpoints": EndpointsAnnouncement(*HEADER, (), 0x803D_0000),
    "writers": WriterConfigurationAnnouncement(*HEADER, (1001, 9), GROUP, (0, 0x803E_0000)),
    "connections": ConnectionsAnnouncement(*HEADER, (CONNECTION_OF_ALL, PLAIN_CONNECTION)),
    "application": ApplicationAnnouncement(*HEADER, APPLICATION, ("DA", "SKS")),
    "cyclic status": StatusAnnouncement(*HEADER, True, PubSubState.OPERATIONAL, TIME + 1, TIME),
    "status": StatusAnnouncement(*HEADER, False, PubSubState.DISABLED),
    "responder": ActionResponderAnnouncement(*HEADER, (CONNECTION_OF_ALL,)),
    "actions": ActionMetaDataAnnouncement(
        *HEADER, 1003, (TARGET, ActionTarget(4, None)), MINIMAL_METADATA, FULL_METADATA, (METHOD, METHOD)
    ),
    "application information of another edition": Announcement(7, U16, 5, 9, b"\3\0abc"),
    "of a String publisher": StatusAnnouncement("robot", PublisherIdType.STRING, 0, False, 3),
}
