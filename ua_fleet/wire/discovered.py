"""What discovery tells of a Publisher: configuration, endpoints, status and Actions (OPC 10000-14 6.2, 7.2.4.6).

Plain tuples whose fields have the order that they have on the wire; `None` is a null String or a null structure. Where
the specification allows subtypes, a structure that is not known stays an ExtensionObject with its bytes.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final, NamedTuple

from ua_fleet.values import ExtensionObject, LocalizedText, NodeId, QualifiedName, Variant
from ua_fleet.wire.messages import Announcement, DataSetMetaData, MetaDataAnnouncement

__all__ = [
    "NO_SECURITY",
    "ActionMetaDataAnnouncement",
    "ActionMethod",
    "ActionResponderAnnouncement",
    "ActionTarget",
    "AnyAnnouncement",
    "ApplicationAnnouncement",
    "ApplicationDescription",
    "ApplicationType",
    "ConnectionsAnnouncement",
    "DataSetReader",
    "DataSetWriter",
    "DatagramConnectionTransport",
    "EndpointDescription",
    "EndpointsAnnouncement",
    "JsonDataSetWriterMessage",
    "JsonWriterGroupMessage",
    "KeyValuePair",
    "NetworkAddressUrl",
    "PubSubConnection",
    "PubSubState",
    "ReaderGroup",
    "StatusAnnouncement",
    "UadpDataSetWriterMessage",
    "UadpWriterGroupMessage",
    "UserTokenPolicy",
    "WriterConfigurationAnnouncement",
    "WriterGroup",
]


NO_SECURITY: Final = 1
"""The MessageSecurityMode None (OPC 10000-4 7.20); 2 is Sign, 3 SignAndEncrypt."""


class PubSubState(IntEnum):
    """PubSubState (OPC 10000-14 6.2.1)."""

    DISABLED = 0
    PAUSED = 1
    OPERATIONAL = 2
    ERROR = 3
    PRE_OPERATIONAL = 4


class ApplicationType(IntEnum):
    """ApplicationType (OPC 10000-4 7.4)."""

    SERVER = 0
    CLIENT = 1
    CLIENT_AND_SERVER = 2
    DISCOVERY_SERVER = 3


class KeyValuePair(NamedTuple):
    """KeyValuePair (OPC 10000-5 12.21)."""

    key: QualifiedName
    value: Variant


class ApplicationDescription(NamedTuple):
    """ApplicationDescription (OPC 10000-4 7.2)."""

    application_uri: str | None = None
    product_uri: str | None = None
    application_name: LocalizedText = LocalizedText(None)
    application_type: int = ApplicationType.SERVER
    gateway_server_uri: str | None = None
    discovery_profile_uri: str | None = None
    discovery_urls: tuple[str, ...] = ()


class UserTokenPolicy(NamedTuple):
    """UserTokenPolicy (OPC 10000-4 7.42)."""

    policy_id: str | None
    token_type: int
    """0 anonymous, 1 user name, 2 certificate, 3 issued token."""
    issued_token_type: str | None = None
    issuer_endpoint_url: str | None = None
    security_policy_uri: str | None = None


class EndpointDescription(NamedTuple):
    """EndpointDescription (OPC 10000-4 7.14)."""

    endpoint_url: str | None
    server: ApplicationDescription
    server_certificate: bytes | None
    security_mode: int
    security_policy_uri: str | None
    user_identity_tokens: tuple[UserTokenPolicy, ...] = ()
    transport_profile_uri: str | None = None
    security_level: int = 0


class NetworkAddressUrl(NamedTuple):
    """NetworkAddressUrlDataType (OPC 10000-14 6.2.7.5.4)."""

    network_interface: str | None
    url: str | None


class DatagramConnectionTransport(NamedTuple):
    """DatagramConnectionTransport2DataType (OPC 10000-14 6.4.1.2.7)."""

    discovery_address: NetworkAddressUrl | ExtensionObject | None = None
    discovery_announce_rate: int = 0
    """Seconds between cyclic announcements; 0 for none but answers."""
    discovery_max_message_size: int = 0
    qos_category: str | None = None
    datagram_qos: tuple[ExtensionObject, ...] = ()


class UadpWriterGroupMessage(NamedTuple):
    """UadpWriterGroupMessageDataType (OPC 10000-14 6.3.1.2.7)."""

    group_version: int = 0
    data_set_ordering: int = 0
    network_message_content_mask: int = 0
    sampling_offset: float = -1.0
    publishing_offset: tuple[float, ...] = ()


class UadpDataSetWriterMessage(NamedTuple):
    """UadpDataSetWriterMessageDataType (OPC 10000-14 6.3.1.3.6)."""

    data_set_message_content_mask: int = 0
    configured_size: int = 0
    network_message_number: int = 0
    data_set_offset: int = 0


class JsonWriterGroupMessage(NamedTuple):
    """JsonWriterGroupMessageDataType (OPC 10000-14 6.3.2.1.2)."""

    network_message_content_mask: int = 0


class JsonDataSetWriterMessage(NamedTuple):
    """JsonDataSetWriterMessageDataType (OPC 10000-14 6.3.2.3.2)."""

    data_set_message_content_mask: int = 0


class DataSetWriter(NamedTuple):
    """DataSetWriterDataType (OPC 10000-14 6.2.4.5)."""

    name: str | None
    enabled: bool
    data_set_writer_id: int
    data_set_field_content_mask: int = 0
    key_frame_count: int = 1
    data_set_name: str | None = None
    properties: tuple[KeyValuePair, ...] = ()
    transport_settings: ExtensionObject | None = None
    message_settings: UadpDataSetWriterMessage | JsonDataSetWriterMessage | ExtensionObject | None = None


class WriterGroup(NamedTuple):
    """WriterGroupDataType with what it inherits of PubSubGroupDataType (OPC 10000-14 6.2.5.7, 6.2.6.7)."""

    name: str | None
    enabled: bool
    security_mode: int = NO_SECURITY
    security_group_id: str | None = None
    security_key_services: tuple[EndpointDescription, ...] = ()
    max_network_message_size: int = 0
    properties: tuple[KeyValuePair, ...] = ()
    writer_group_id: int = 0
    publishing_interval_ms: float = 0.0
    keep_alive_time_ms: float = 0.0
    priority: int = 0
    locale_ids: tuple[str, ...] = ()
    header_layout_uri: str | None = None
    transport_settings: ExtensionObject | None = None
    message_settings: UadpWriterGroupMessage | JsonWriterGroupMessage | ExtensionObject | None = None
    data_set_writers: tuple[DataSetWriter, ...] = ()


class DataSetReader(NamedTuple):
    """DataSetReaderDataType (OPC 10000-14 6.2.9.13). Announcements should have none, peers may send them."""

    name: str | None
    enabled: bool
    publisher_id: Variant
    writer_group_id: int
    data_set_writer_id: int
    metadata: DataSetMetaData
    data_set_field_content_mask: int = 0
    message_receive_timeout_ms: float = 0.0
    key_frame_count: int = 1
    header_layout_uri: str | None = None
    security_mode: int = NO_SECURITY
    security_group_id: str | None = None
    security_key_services: tuple[EndpointDescription, ...] = ()
    properties: tuple[KeyValuePair, ...] = ()
    transport_settings: ExtensionObject | None = None
    message_settings: ExtensionObject | None = None
    subscribed_data_set: ExtensionObject | None = None


class ReaderGroup(NamedTuple):
    """ReaderGroupDataType with what it inherits of PubSubGroupDataType (OPC 10000-14 6.2.8.2)."""

    name: str | None
    enabled: bool
    security_mode: int = NO_SECURITY
    security_group_id: str | None = None
    security_key_services: tuple[EndpointDescription, ...] = ()
    max_network_message_size: int = 0
    properties: tuple[KeyValuePair, ...] = ()
    transport_settings: ExtensionObject | None = None
    message_settings: ExtensionObject | None = None
    data_set_readers: tuple[DataSetReader, ...] = ()


class PubSubConnection(NamedTuple):
    """PubSubConnectionDataType (OPC 10000-14 6.2.7.5.1)."""

    name: str | None
    enabled: bool
    publisher_id: Variant
    transport_profile_uri: str | None
    address: NetworkAddressUrl | ExtensionObject | None = None
    properties: tuple[KeyValuePair, ...] = ()
    transport_settings: DatagramConnectionTransport | ExtensionObject | None = None
    writer_groups: tuple[WriterGroup, ...] = ()
    reader_groups: tuple[ReaderGroup, ...] = ()


class ActionTarget(NamedTuple):
    """ActionTargetDataType (OPC 10000-14 6.2.3.10.3)."""

    action_target_id: int
    name: str | None
    description: LocalizedText = LocalizedText(None)


class ActionMethod(NamedTuple):
    """ActionMethodDataType (OPC 10000-14 6.2.3.10.5)."""

    object_id: NodeId
    method_id: NodeId


class EndpointsAnnouncement(NamedTuple):
    """The Endpoints of the Publisher's OPC UA Server (OPC 10000-14 7.2.4.6.6)."""

    publisher_id: int | str | None
    publisher_id_type: int
    sequence_number: int
    endpoints: tuple[EndpointDescription, ...]
    status: int = 0


class WriterConfigurationAnnouncement(NamedTuple):
    """A WriterGroup and those of its DataSetWriters that were asked for or have changed (OPC 10000-14 7.2.4.6.9)."""

    publisher_id: int | str | None
    publisher_id_type: int
    sequence_number: int
    data_set_writer_ids: tuple[int, ...]
    writer_group: WriterGroup
    statuses: tuple[int, ...]
    """One for each of `data_set_writer_ids`."""


class ConnectionsAnnouncement(NamedTuple):
    """The PubSubConnections of an application (OPC 10000-14 7.2.4.6.8)."""

    publisher_id: int | str | None
    publisher_id_type: int
    sequence_number: int
    connections: tuple[PubSubConnection, ...]


class ApplicationAnnouncement(NamedTuple):
    """Which application a Publisher is, and its capabilities (OPC 10000-14 7.2.4.6.5)."""

    publisher_id: int | str | None
    publisher_id_type: int
    sequence_number: int
    description: ApplicationDescription
    capabilities: tuple[str, ...] = ()


class StatusAnnouncement(NamedTuple):
    """How a PubSubConnection is (OPC 10000-14 7.2.4.6.7). The two times are there where it is cyclic, as ticks."""

    publisher_id: int | str | None
    publisher_id_type: int
    sequence_number: int
    is_cyclic: bool
    state: int
    next_report_time: int | None = None
    timestamp: int | None = None


class ActionResponderAnnouncement(NamedTuple):
    """The PubSubConnections with only what is used for Actions (OPC 10000-14 7.2.4.6.10)."""

    publisher_id: int | str | None
    publisher_id_type: int
    sequence_number: int
    connections: tuple[PubSubConnection, ...]


class ActionMetaDataAnnouncement(NamedTuple):
    """The Actions of one DataSetWriter: what is asked, what is answered, and of whom (OPC 10000-14 7.2.4.6.11)."""

    publisher_id: int | str | None
    publisher_id_type: int
    sequence_number: int
    data_set_writer_id: int
    targets: tuple[ActionTarget, ...]
    request: DataSetMetaData
    response: DataSetMetaData
    """Its name and ConfigurationVersion are those of `request`."""
    methods: tuple[ActionMethod, ...] = ()
    """Empty, or one for each of `targets`."""


AnyAnnouncement = (
    MetaDataAnnouncement
    | EndpointsAnnouncement
    | WriterConfigurationAnnouncement
    | ConnectionsAnnouncement
    | ApplicationAnnouncement
    | StatusAnnouncement
    | ActionResponderAnnouncement
    | ActionMetaDataAnnouncement
    | Announcement
)
