"""What of the standard's nodes this server has, and what they say.

asyncua makes every node of the standard's NodeSet, of all optional parts as well. A node that is there without anything
behind it misleads: a Variable is Null and Good, a Method is Executable and answers Bad_NotImplemented. So

* optional Objects, Variables and Methods that nothing stands behind leave the address space;
* mandatory ones get the value that holds for this server (`diagnostics` has those that change);
* Variables that are InstanceDeclarations, whose access level and value OPC 10000-5 5.3 leaves to the server, cannot be
  read where the standard gives no value;
* a VariableType without a default value has no attribute Value (OPC 10000-3 5.6.5).

Methods of ObjectTypes stay as the standard has them. Instances share them, or have their own.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.limits import EndpointLimits
from ua_fleet.endpoint.node_builder import nodes_of
from ua_fleet.endpoint.stack import AttributeIds, ObjectIds, ns0

__all__ = ["close_declarations", "fill_pubsub", "fill_standard_nodes", "remove_unsupported", "set_value"]

_BELOW: Final = frozenset(
    (
        ObjectIds.Organizes,
        ObjectIds.HasComponent,
        ObjectIds.HasOrderedComponent,
        ObjectIds.HasProperty,
        ObjectIds.HasAddIn,
    )
)
"""ReferenceTypes, by their numbers: whoever goes through all references would hash each type's NodeId."""
_READ: Final = 1 << ua.AccessLevel.CurrentRead.value

_UNSUPPORTED: Final = (
    # OPC 10000-17: no aliases. OPC 10000-22: the network's state is the computer's. OPC 10000-26: logs are files.
    "Aliases",
    "Resources",
    "ServerLog",
    # OPC 10000-12: certificates, trust and users are managed at the server's own command line.
    "ServerConfiguration",
    # OPC 10000-18: roles are this server's own; `ua-fleet user` gives them.
    "Server_ServerCapabilities_RoleSet",
    "OPCUANamespaceMetadata_DefaultRolePermissions",
    "OPCUANamespaceMetadata_DefaultUserRolePermissions",
    "OPCUANamespaceMetadata_DefaultAccessRestrictions",
    # OPC 10000-11: no history.
    "DefaultHAConfiguration",
    "DefaultHEConfiguration",
    "HAConfiguration",
    # OPC 10000-20: no files.
    "FileSystem",
    # OPC 10000-4 6.8: no subscription outlasts the server. OPC 10000-5 9.4: nobody stops it from a client.
    "Server_SetSubscriptionDurable",
    "Server_RequestServerStateChange",
    # OPC 10000-5: optional, and not kept.
    "Server_UrisVersion",
    "Server_EstimatedReturnTime",
    "Server_LocalTime",
    "Server_ServerCapabilities_ConformanceUnits",
    "Server_ServerCapabilities_MaxArrayLength",
    "Server_ServerCapabilities_MaxStringLength",
    "Server_ServerCapabilities_MaxByteStringLength",
    "Server_ServerCapabilities_MaxMonitoredItems",
    "Server_ServerDiagnostics_SamplingIntervalDiagnosticsArray",
    "Server_ServerRedundancy_RedundantServerArray",
    "Server_ServerRedundancy_CurrentServerId",
    "Server_ServerRedundancy_ServerUriArray",
    "Server_ServerRedundancy_ServerNetworkGroups",
)
"""Nodes that leave, with all that is below them."""

_PUBSUB: Final = "PublishSubscribe"
_KEY_SERVICE: Final = ("GetSecurityKeys", "GetSecurityGroup", "SecurityGroups")
"""Of PublishSubscribe, where this server gives keys."""
_PUSHED_KEYS: Final = ("SetSecurityKeys", "PubSubCapablities_SupportSecurityKeyPush")
"""Of PublishSubscribe, where a foreign key service pushes keys to this server."""
_NOT_CONFIGURED: Final = (
    "SubscribedDataSets",
    "DataSetClasses",
    "AddConnection",
    "RemoveConnection",
    "KeyPushTargets",
    "PubSubConfiguration",
    "DefaultDatagramPublisherId",
    "ConfigurationVersion",
    "DefaultSecurityKeyServices",
    "ConfigurationProperties",
    *(
        f"PubSubCapablities_{name}"
        for name in (
            "MaxDataSetWritersPerGroup",
            "MaxSecurityGroups",
            "MaxPushTargets",
            "MaxPublishedDataSets",
            "MaxStandaloneSubscribedDataSets",
            "MaxNetworkMessageSizeDatagram",
            "MaxNetworkMessageSizeBroker",
            "SupportSecurityKeyPull",
        )
    ),
)
"""Of PublishSubscribe: PubSub is configured in `fleet.yaml`, and its PubSubConnections are what is switched."""
_PUBSUB_LIMITS: Final = (
    ("MaxPubSubConnections", 1),
    ("MaxWriterGroups", 0xFFFF),
    ("MaxReaderGroups", 0xFFFF),
    ("MaxDataSetWriters", 0xFFFF),
    ("MaxDataSetReaders", 50_000),
    ("MaxFieldsPerDataSet", 0xFFFF),
)
"""What this server has at most (OPC 10000-14 9.1.12): its ids are UInt16, and so is the FieldCount of a message."""
_NOT_EXECUTABLE: Final = ("SecurityGroups_AddSecurityGroup", "SecurityGroups_RemoveSecurityGroup")
"""Mandatory Methods of a SecurityGroupFolder: here the groups follow from `fleet.yaml`."""

_PROFILES: Final = (
    "http://opcfoundation.org/UA-Profile/Transport/uatcp-uasc-uabinary",
    "http://opcfoundation.org/UA-Profile/Server/Methods",
    "http://opcfoundation.org/UA-Profile/Server/EmbeddedDataChangeSubscription",
)
_LOCALES: Final = ("en",)
_NO_HISTORY: Final = (
    *(
        (name, False, ua.VariantType.Boolean)
        for name in (
            "AccessHistoryDataCapability",
            "AccessHistoryEventsCapability",
            "InsertDataCapability",
            "ReplaceDataCapability",
            "UpdateDataCapability",
            "DeleteRawCapability",
            "DeleteAtTimeCapability",
            "InsertAnnotationCapability",
            "InsertEventCapability",
            "ReplaceEventCapability",
            "UpdateEventCapability",
            "DeleteEventCapability",
            "ServerTimestampSupported",
        )
    ),
    ("MaxReturnDataValues", 0, ua.VariantType.UInt32),
    ("MaxReturnEventValues", 0, ua.VariantType.UInt32),
)


def remove_unsupported(space: AddressSpace, *, key_service: bool, pushed_keys: bool = False) -> None:
    """Take the nodes of the standard's optional parts away.

    Args:
        space: the server's nodes.
        key_service: leave those that keys are asked for at.
        pushed_keys: leave those that keys are pushed to.
    """
    without = [*_NOT_CONFIGURED, *(() if key_service else _KEY_SERVICE), *(() if pushed_keys else _PUSHED_KEYS)]
    names = [*_UNSUPPORTED, *[f"{_PUBSUB}_{name}" for name in without]]
    gone: dict[ua.NodeId, None] = {}
    for name in names:
        gone |= dict.fromkeys(_tree(space, ns0(getattr(ObjectIds, name))))
    around: set[ua.NodeId] = set()
    for node_id in gone:
        around.update(reference.NodeId for reference in space[node_id].references)
    for node_id in around - gone.keys():
        if (node := space.get(node_id)) is not None:
            node.references[:] = [reference for reference in node.references if reference.NodeId not in gone]
    for node_id in gone:
        del space[node_id]


def _tree(space: AddressSpace, top: ua.NodeId) -> Iterator[ua.NodeId]:
    """A node and what is below it, as far as it belongs to that one."""
    waiting = [top]
    while waiting:
        node_id = waiting.pop()
        yield node_id
        waiting += [target for target in _targets_below(space[node_id]) if target in space]


def _targets_below(node: Any) -> list[Any]:
    """What a node refers to as below it."""
    return [
        reference.NodeId
        for reference in node.references
        if reference.IsForward and (kind := reference.ReferenceTypeId).Identifier in _BELOW and not kind.NamespaceIndex
    ]


def close_declarations(space: AddressSpace) -> None:
    """Variables and VariableTypes that are none of an instance, and have no value, do not say that it is Null."""
    nodes = nodes_of(space)
    instances = _reachable(nodes, ns0(ObjectIds.ObjectsFolder))
    closed = HeldValue(ua.DataValue(ua.Variant(0, ua.VariantType.Byte)))
    for node in nodes.values():
        attributes: Any = node.attributes
        held = attributes.get(AttributeIds.Value)
        if held is None or held.value_callback is not None or id(node) in instances:
            continue
        if held.value is not None and held.value.Value is not None and held.value.Value.Value is not None:
            continue
        if attributes[AttributeIds.NodeClass].value.Value.Value == ua.NodeClass.VariableType:
            del attributes[AttributeIds.Value]
        else:
            attributes[AttributeIds.AccessLevel] = attributes[AttributeIds.UserAccessLevel] = closed


def _reachable(nodes: Mapping[ua.NodeId, Any], top: ua.NodeId) -> set[int]:
    """What is below a node, by what `id` says of the nodes: to hash a NodeId takes longer than all the rest."""
    first = nodes[top]
    seen = {id(first)}
    waiting = [first]
    while waiting:
        for target in _targets_below(waiting.pop()):
            node = nodes.get(target)
            if node is not None and id(node) not in seen:
                seen.add(id(node))
                waiting.append(node)
    return seen


def fill_standard_nodes(space: AddressSpace, limits: EndpointLimits, policies: Iterable[str]) -> None:
    """Give the mandatory nodes their values, as far as these never change.

    Args:
        space: the server's nodes.
        limits: what is enforced.
        policies: URIs of the SecurityPolicies of its endpoints, which are profiles of a server, too.
    """
    capabilities = "Server_ServerCapabilities_"
    profiles = [*_PROFILES, *dict.fromkeys(policies)]
    elements = limits.filter_elements
    for name, value, variant_type in (
        (f"{capabilities}ServerProfileArray", profiles, ua.VariantType.String),
        (f"{capabilities}LocaleIdArray", list(_LOCALES), ua.VariantType.String),
        (f"{capabilities}SoftwareCertificates", list[Any](), ua.VariantType.ExtensionObject),
        # These services are not supported; 0 would be no limit if they were (OPC 10000-5 6.3.2).
        (f"{capabilities}MaxQueryContinuationPoints", 0, ua.VariantType.UInt16),
        (f"{capabilities}MaxHistoryContinuationPoints", 0, ua.VariantType.UInt16),
        (f"{capabilities}MaxSelectClauseParameters", elements, ua.VariantType.UInt32),
        (f"{capabilities}MaxWhereClauseParameters", elements, ua.VariantType.UInt32),
        ("Server_ServerRedundancy_RedundancySupport", ua.RedundancySupport(0), ua.VariantType.Int32),
        ("Server_ServerStatus_SecondsTillShutdown", 0, ua.VariantType.UInt32),
        ("Server_ServerStatus_ShutdownReason", ua.LocalizedText(""), ua.VariantType.LocalizedText),
        ("Server_Auditing", True, ua.VariantType.Boolean),
        ("OPCUANamespaceMetadata_StaticStringNodeIdPattern", "", ua.VariantType.String),
        *((f"HistoryServerCapabilities_{name}", value, variant_type) for name, value, variant_type in _NO_HISTORY),
    ):
        set_value(space, ns0(getattr(ObjectIds, name)), value, variant_type)


def fill_pubsub(space: AddressSpace, *, key_service: bool, pushed_keys: bool = False) -> None:
    """Give PublishSubscribe the values that never change; `server.pubsub_model` gives it the others."""
    capabilities = f"{_PUBSUB}_PubSubCapablities_"
    for name, value in _PUBSUB_LIMITS:
        set_value(space, ns0(getattr(ObjectIds, f"{capabilities}{name}")), value, ua.VariantType.UInt32)
    server_of_keys = ns0(getattr(ObjectIds, f"{capabilities}SupportSecurityKeyServer"))
    set_value(space, server_of_keys, key_service, ua.VariantType.Boolean)
    if pushed_keys:
        takes_keys = ns0(getattr(ObjectIds, f"{capabilities}SupportSecurityKeyPush"))
        set_value(space, takes_keys, True, ua.VariantType.Boolean)
    refused = HeldValue(ua.DataValue(ua.Variant(False, ua.VariantType.Boolean)))
    for name in _NOT_EXECUTABLE if key_service else ():
        attributes: Any = space[ns0(getattr(ObjectIds, f"{_PUBSUB}_{name}"))].attributes
        attributes[AttributeIds.Executable] = attributes[AttributeIds.UserExecutable] = refused


def set_value(space: AddressSpace, node_id: ua.NodeId, value: Any, variant_type: ua.VariantType) -> None:
    """Give a Variable a value that is good now."""
    now: Any = datetime.now(UTC)
    variant = ua.Variant(value, variant_type, is_array=isinstance(value, list))
    space[node_id].attributes[AttributeIds.Value].value = ua.DataValue(
        variant, ua.StatusCode(ua.UInt32(0)), SourceTimestamp=now, ServerTimestamp=now
    )
