"""Our structures of discovery as those of asyncua: a second implementation of their bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from asyncua import ua as typed_ua

from ua_fleet.values import ARRAY, ExtensionObject, LocalizedText, NodeId, Variant
from ua_fleet.wire.discovered import (
    ApplicationDescription,
    DatagramConnectionTransport,
    DataSetReader,
    DataSetWriter,
    EndpointDescription,
    KeyValuePair,
    NetworkAddressUrl,
    PubSubConnection,
    ReaderGroup,
    UadpDataSetWriterMessage,
    UadpWriterGroupMessage,
    WriterGroup,
)
from ua_fleet.wire.messages import DataSetMetaData, FieldMetaData

ua: Any = typed_ua
"""Its integer types are not ours."""


def text(value: LocalizedText) -> Any:
    return ua.LocalizedText(value.text, value.locale)


def variant(value: Variant) -> Any:
    parts: Any = value.value
    plain = list(parts) if value.type & ARRAY else parts
    return ua.Variant(plain, ua.VariantType(value.type & ~ARRAY))


def pairs(values: tuple[KeyValuePair, ...]) -> Any:
    return [ua.KeyValuePair(ua.QualifiedName(key.name, key.namespace), variant(value)) for key, value in values]


def raw(value: Any) -> Any:
    if not isinstance(value, ExtensionObject):
        return value and EXTENSIONS[type(value)](value)
    return ua.ExtensionObject(ua.NodeId(value.type_id.identifier, value.type_id.namespace), value.body)


def application(value: ApplicationDescription) -> Any:
    uri, product, name, kind, gateway, profile, urls = value
    return ua.ApplicationDescription(uri, product, text(name), ua.ApplicationType(kind), gateway, profile, list(urls))


def endpoint(value: EndpointDescription) -> Any:
    tokens = [
        ua.UserTokenPolicy(token.policy_id, ua.UserTokenType(token.token_type), *token[2:])
        for token in value.user_identity_tokens
    ]
    mode = ua.MessageSecurityMode(value.security_mode)
    head = value.endpoint_url, application(value.server), value.server_certificate, mode, value.security_policy_uri
    return ua.EndpointDescription(*head, tokens, value.transport_profile_uri, value.security_level)


def address(value: NetworkAddressUrl) -> Any:
    return ua.NetworkAddressUrlDataType(value.network_interface, value.url)


def writer(value: DataSetWriter) -> Any:
    return ua.DataSetWriterDataType(
        value.name,
        value.enabled,
        value.data_set_writer_id,
        ua.DataSetFieldContentMask(value.data_set_field_content_mask),
        value.key_frame_count,
        value.data_set_name,
        pairs(value.properties),
        raw(value.transport_settings),
        raw(value.message_settings),
    )


def group_head(value: WriterGroup | ReaderGroup) -> tuple[Any, ...]:
    mode = ua.MessageSecurityMode(value.security_mode)
    services = [endpoint(service) for service in value.security_key_services]
    size = value.max_network_message_size
    return value.name, value.enabled, mode, value.security_group_id, services, size, pairs(value.properties)


def writer_group(value: WriterGroup) -> Any:
    return ua.WriterGroupDataType(
        *group_head(value),
        value.writer_group_id,
        value.publishing_interval_ms,
        value.keep_alive_time_ms,
        value.priority,
        list(value.locale_ids),
        value.header_layout_uri,
        raw(value.transport_settings),
        raw(value.message_settings),
        [writer(part) for part in value.data_set_writers],
    )


def metadata(value: DataSetMetaData) -> Any:
    version = ua.ConfigurationVersionDataType(*value.configuration_version)
    fields = [field(part) for part in value.fields]
    head: tuple[Any, ...] = (list(value.namespaces), [], [], [])
    return ua.DataSetMetaDataType(*head, value.name, text(value.description), fields, value.data_set_class_id, version)


def field(value: FieldMetaData) -> Any:
    kind = value.data_type or NodeId(0, value.builtin_type)
    properties = tuple(KeyValuePair(key, Variant(code, part)) for key, code, part in value.properties)
    return ua.FieldMetaData(
        value.name,
        text(value.description),
        ua.DataSetFieldFlags(value.field_flags),
        value.builtin_type,
        ua.NodeId(kind.identifier, kind.namespace),
        value.value_rank,
        list(value.array_dimensions),
        value.max_string_length,
        value.data_set_field_id,
        pairs(properties),
    )


def reader_group(value: ReaderGroup) -> Any:
    return ua.ReaderGroupDataType(
        *group_head(value),
        raw(value.transport_settings),
        raw(value.message_settings),
        [reader(part) for part in value.data_set_readers],
    )


def reader(value: DataSetReader) -> Any:
    return ua.DataSetReaderDataType(
        value.name,
        value.enabled,
        variant(value.publisher_id),
        value.writer_group_id,
        value.data_set_writer_id,
        metadata(value.metadata),
        ua.DataSetFieldContentMask(value.data_set_field_content_mask),
        value.message_receive_timeout_ms,
        value.key_frame_count,
        value.header_layout_uri,
        ua.MessageSecurityMode(value.security_mode),
        value.security_group_id,
        [endpoint(service) for service in value.security_key_services],
        pairs(value.properties),
        raw(value.transport_settings),
        raw(value.message_settings),
        raw(value.subscribed_data_set),
    )


def connection(value: PubSubConnection) -> Any:
    return ua.PubSubConnectionDataType(
        value.name,
        value.enabled,
        variant(value.publisher_id),
        value.transport_profile_uri,
        raw(value.address),
        pairs(value.properties),
        raw(value.transport_settings),
        [writer_group(part) for part in value.writer_groups],
        [reader_group(part) for part in value.reader_groups],
    )


def connection_transport(value: DatagramConnectionTransport) -> Any:
    qos = [raw(part) for part in value.datagram_qos]
    rate, size = value.discovery_announce_rate, value.discovery_max_message_size
    return ua.DatagramConnectionTransport2DataType(raw(value.discovery_address), rate, size, value.qos_category, qos)


def group_message(value: UadpWriterGroupMessage) -> Any:
    order = ua.DataSetOrderingType(value.data_set_ordering)
    mask = ua.UadpNetworkMessageContentMask(value.network_message_content_mask)
    return ua.UadpWriterGroupMessageDataType(
        value.group_version, order, mask, value.sampling_offset, list(value.publishing_offset)
    )


def writer_message(value: UadpDataSetWriterMessage) -> Any:
    mask = ua.UadpDataSetMessageContentMask(value.data_set_message_content_mask)
    return ua.UadpDataSetWriterMessageDataType(mask, *value[1:])


EXTENSIONS: dict[type, Callable[[Any], Any]] = {
    NetworkAddressUrl: address,
    DatagramConnectionTransport: connection_transport,
    UadpWriterGroupMessage: group_message,
    UadpDataSetWriterMessage: writer_message,
}
