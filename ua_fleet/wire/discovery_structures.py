"""The structures of discovery, each with its members in their order (OPC 10000-14 6.2 and 6.3, OPC 10000-4 7).

They are the same in every encoding. `Forms` says how one encoding makes what they are made of: see `configuration.py`
and `json/configuration.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from ua_fleet.wire import discovered as d

__all__ = ["Forms", "KnownStructure", "Structures", "make_structures"]

F = TypeVar("F")


class KnownStructure(NamedTuple, Generic[F]):
    """A structure that an ExtensionObject may hold."""

    encoding: int
    """Of its Default Binary encoding, the NodeId in namespace 0 (OPC 10000-6 annex A)."""
    data_type: int
    """Of its DataType, which JSON names."""
    kind: type
    form: F


class Forms(NamedTuple, Generic[F]):
    """What one encoding makes structures of."""

    boolean: F
    byte: F
    uint16: F
    uint32: F
    double: F
    enumeration: F
    string: F
    text: F
    """A String of which null and empty are the same."""
    byte_string: F
    node_id: F
    localized_text: F
    variant: F
    metadata: F
    """A DataSetMetaDataType."""
    properties: F
    """An array of KeyValuePair."""
    structure: Callable[..., F]
    """(kind, **members): a structure that becomes a NamedTuple, with the names of its members in the specification."""
    array: Callable[[F], F]
    extension: Callable[..., F]
    """(*known): a structure of which subtypes are allowed, with those that are known."""


class Structures(NamedTuple, Generic[F]):
    """Those that messages hold."""

    application_description: F
    endpoint_description: F
    address: F
    """Of a PubSubConnection."""
    writer_group: F
    connection: F
    action_target: F
    action_method: F


def make_structures(f: Forms[F]) -> Structures[F]:
    """The structures in one encoding."""
    application, endpoint = _application_and_endpoint(f)
    # PubSubGroupDataType, from which both kinds of groups inherit.
    group = {
        "Name": f.string,
        "Enabled": f.boolean,
        "SecurityMode": f.enumeration,
        "SecurityGroupId": f.string,
        "SecurityKeyServices": f.array(endpoint),
        "MaxNetworkMessageSize": f.uint32,
        "GroupProperties": f.properties,
    }
    writer_group, reader_group = _writer_group(f, group), _reader_group(f, group)
    url = f.structure(d.NetworkAddressUrl, NetworkInterface=f.string, Url=f.string)
    address = f.extension(KnownStructure(21152, 15510, d.NetworkAddressUrl, url))
    return Structures(
        application,
        endpoint,
        address,
        writer_group,
        _connection(f, address, writer_group, reader_group),
        f.structure(d.ActionTarget, ActionTargetId=f.uint16, Name=f.string, Description=f.localized_text),
        f.structure(d.ActionMethod, ObjectId=f.node_id, MethodId=f.node_id),
    )


def _application_and_endpoint(f: Forms[F]) -> tuple[F, F]:
    application = f.structure(
        d.ApplicationDescription,
        ApplicationUri=f.string,
        ProductUri=f.string,
        ApplicationName=f.localized_text,
        ApplicationType=f.enumeration,
        GatewayServerUri=f.string,
        DiscoveryProfileUri=f.string,
        DiscoveryUrls=f.array(f.text),
    )
    token_policy = f.structure(
        d.UserTokenPolicy,
        PolicyId=f.string,
        TokenType=f.enumeration,
        IssuedTokenType=f.string,
        IssuerEndpointUrl=f.string,
        SecurityPolicyUri=f.string,
    )
    endpoint = f.structure(
        d.EndpointDescription,
        EndpointUrl=f.string,
        Server=application,
        ServerCertificate=f.byte_string,
        SecurityMode=f.enumeration,
        SecurityPolicyUri=f.string,
        UserIdentityTokens=f.array(token_policy),
        TransportProfileUri=f.string,
        SecurityLevel=f.byte,
    )
    return application, endpoint


def _writer_group(f: Forms[F], group: dict[str, F]) -> F:
    uadp_writer = f.structure(
        d.UadpDataSetWriterMessage,
        DataSetMessageContentMask=f.uint32,
        ConfiguredSize=f.uint16,
        NetworkMessageNumber=f.uint16,
        DataSetOffset=f.uint16,
    )
    json_writer = f.structure(d.JsonDataSetWriterMessage, DataSetMessageContentMask=f.uint32)
    uadp_group = f.structure(
        d.UadpWriterGroupMessage,
        GroupVersion=f.uint32,
        DataSetOrdering=f.enumeration,
        NetworkMessageContentMask=f.uint32,
        SamplingOffset=f.double,
        PublishingOffset=f.array(f.double),
    )
    json_group = f.structure(d.JsonWriterGroupMessage, NetworkMessageContentMask=f.uint32)
    writer = f.structure(
        d.DataSetWriter,
        Name=f.string,
        Enabled=f.boolean,
        DataSetWriterId=f.uint16,
        DataSetFieldContentMask=f.uint32,
        KeyFrameCount=f.uint32,
        DataSetName=f.string,
        DataSetWriterProperties=f.properties,
        TransportSettings=f.extension(),
        MessageSettings=f.extension(
            KnownStructure(15717, 15652, d.UadpDataSetWriterMessage, uadp_writer),
            KnownStructure(15724, 15664, d.JsonDataSetWriterMessage, json_writer),
        ),
    )
    return f.structure(
        d.WriterGroup,
        **group,
        WriterGroupId=f.uint16,
        PublishingInterval=f.double,
        KeepAliveTime=f.double,
        Priority=f.byte,
        LocaleIds=f.array(f.text),
        HeaderLayoutUri=f.string,
        TransportSettings=f.extension(),
        MessageSettings=f.extension(
            KnownStructure(15715, 15645, d.UadpWriterGroupMessage, uadp_group),
            KnownStructure(15719, 15657, d.JsonWriterGroupMessage, json_group),
        ),
        DataSetWriters=f.array(writer),
    )


def _reader_group(f: Forms[F], group: dict[str, F]) -> F:
    reader = f.structure(
        d.DataSetReader,
        Name=f.string,
        Enabled=f.boolean,
        PublisherId=f.variant,
        WriterGroupId=f.uint16,
        DataSetWriterId=f.uint16,
        DataSetMetaData=f.metadata,
        DataSetFieldContentMask=f.uint32,
        MessageReceiveTimeout=f.double,
        KeyFrameCount=f.uint32,
        HeaderLayoutUri=f.string,
        SecurityMode=group["SecurityMode"],
        SecurityGroupId=group["SecurityGroupId"],
        SecurityKeyServices=group["SecurityKeyServices"],
        DataSetReaderProperties=f.properties,
        TransportSettings=f.extension(),
        MessageSettings=f.extension(),
        SubscribedDataSet=f.extension(),
    )
    return f.structure(
        d.ReaderGroup,
        **group,
        TransportSettings=f.extension(),
        MessageSettings=f.extension(),
        DataSetReaders=f.array(reader),
    )


def _connection(f: Forms[F], address: F, writer_group: F, reader_group: F) -> F:
    datagram = f.structure(
        d.DatagramConnectionTransport,
        DiscoveryAddress=address,
        DiscoveryAnnounceRate=f.uint32,
        DiscoveryMaxMessageSize=f.uint32,
        QosCategory=f.string,
        DatagramQos=f.array(f.extension()),
    )
    return f.structure(
        d.PubSubConnection,
        Name=f.string,
        Enabled=f.boolean,
        PublisherId=f.variant,
        TransportProfileUri=f.string,
        Address=address,
        ConnectionProperties=f.properties,
        TransportSettings=f.extension(KnownStructure(23864, 23612, d.DatagramConnectionTransport, datagram)),
        WriterGroups=f.array(writer_group),
        ReaderGroups=f.array(reader_group),
    )
