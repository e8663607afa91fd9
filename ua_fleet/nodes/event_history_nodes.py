"""What the address space says of the history of events (OPC 10000-11 5.3): the Server object has one, and which fields.

Server        EventNotifier: SubscribeToEvents, HistoryRead
  HistoricalEventFilter       the fields of all events that are kept
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.convert import raw_id
from ua_fleet.endpoint.history_source import MOST_EVENTS
from ua_fleet.endpoint.node_builder import HAS_COMPONENT, HAS_PROPERTY, HISTORY_READ
from ua_fleet.endpoint.stack import AttributeIds, ObjectIds, ns0
from ua_fleet.endpoint.standard_model import set_value
from ua_fleet.nodes.node_factory import STANDARD, NodeFactory
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId
from ua_fleet.values import QualifiedName

__all__ = ["show_event_history"]

_PATH: Final = "Fleet.History.HistoricalEventFilter"
_SERVER: Final = ns0(ObjectIds.Server)
_SUBSCRIBE: Final = 1
"""Bit SubscribeToEvents of EventNotifier (OPC 10000-3 8.59)."""
_OWN_TYPES: Final = tuple(
    raw_id(each.value, TYPES_INDEX)
    for each in (
        TypeId.SKILL_TRANSITION_EVENT,
        TypeId.FAULT_ALARM,
        TypeId.RUN_EVENT,
        TypeId.STEP_EVENT,
        TypeId.DECISION_EVENT,
        TypeId.SKILL_REQUEST_EVENT,
        TypeId.ROBOT_HOLD_EVENT,
    )
)
_FIELDS: Final = (
    ("BaseEventType", "EventId EventType SourceNode SourceName Time ReceiveTime Message Severity"),
    ("GeneralModelChangeEventType", "Changes"),
    (
        "ConditionType",
        (
            "ConditionClassId ConditionClassName ConditionName BranchId Retain EnabledState EnabledState/Id Quality"
            " Quality/SourceTimestamp LastSeverity LastSeverity/SourceTimestamp Comment Comment/SourceTimestamp"
            " ClientUserId"
        ),
    ),
    ("AcknowledgeableConditionType", "AckedState AckedState/Id ConfirmedState ConfirmedState/Id"),
    (
        "AlarmConditionType",
        (
            "ActiveState ActiveState/Id ActiveState/TransitionTime InputNode SuppressedState SuppressedState/Id"
            " SuppressedOrShelved ShelvingState/CurrentState ShelvingState/CurrentState/Id ShelvingState/UnshelveTime"
            " MaxTimeShelved OnDelay"
        ),
    ),
    ("OffNormalAlarmType", "NormalState"),
    ("LimitAlarmType", "HighHighLimit HighLimit LowLimit LowLowLimit"),
    ("ExclusiveLimitAlarmType", "LimitState/CurrentState LimitState/CurrentState/Id"),
    ("CertificateExpirationAlarmType", "ExpirationDate ExpirationLimit CertificateType Certificate"),
    (
        "DialogConditionType",
        "DialogState DialogState/Id Prompt ResponseOptionSet DefaultResponse OkResponse CancelResponse LastResponse",
    ),
    (
        "TransitionEventType",
        (
            "Transition Transition/Id Transition/Number FromState FromState/Id FromState/Number ToState ToState/Id"
            " ToState/Number"
        ),
    ),
    ("ProgramTransitionEventType", "IntermediateResult"),
)
_AUDIT_FIELDS: Final = (
    ("AuditEventType", "ActionTimeStamp Status ServerId ClientAuditEntryId ClientUserId"),
    ("AuditSecurityEventType", "StatusCodeId"),
    ("AuditChannelEventType", "SecureChannelId"),
    (
        "AuditOpenSecureChannelEventType",
        "ClientCertificate ClientCertificateThumbprint RequestType SecurityPolicyUri SecurityMode RequestedLifetime",
    ),
    ("AuditSessionEventType", "SessionId"),
    (
        "AuditCreateSessionEventType",
        "SecureChannelId ClientCertificate ClientCertificateThumbprint RevisedSessionTimeout",
    ),
    ("AuditActivateSessionEventType", "ClientSoftwareCertificates UserIdentityToken SecureChannelId"),
    ("AuditCertificateEventType", "Certificate"),
    ("AuditWriteUpdateEventType", "AttributeId IndexRange NewValue OldValue"),
    ("AuditUpdateMethodEventType", "MethodId StatusCodeId InputArguments OutputArguments"),
)


def show_event_history(space: AddressSpace, parts: NodeFactory, *, audit: bool) -> None:
    """Say that the events of the Server object are kept, with AuditEvents or without."""
    capabilities = "HistoryServerCapabilities_"
    for name, value, kind in (
        ("AccessHistoryEventsCapability", True, ua.VariantType.Boolean),
        ("MaxReturnEventValues", MOST_EVENTS, ua.VariantType.UInt32),
    ):
        set_value(space, ns0(getattr(ObjectIds, capabilities + name)), value, kind)
    notifier = ua.DataValue(ua.Variant(_SUBSCRIBE | HISTORY_READ, ua.VariantType.Byte))
    # A new object: the one that is there is shared with all attributes of that content, AccessLevels among them.
    attributes: Any = space[_SERVER].attributes
    attributes[AttributeIds.EventNotifier] = HeldValue(notifier)
    parts.builder.add_variable(
        parts.id(_PATH),
        QualifiedName(0, "HistoricalEventFilter"),
        _SERVER,
        STANDARD["PropertyType"],
        data_type=ns0(ObjectIds.EventFilter),
        value=ua.DataValue(ua.Variant(_filter(space, audit=audit), ua.VariantType.ExtensionObject)),
        reference=HAS_PROPERTY,
    )


def _filter(space: AddressSpace, *, audit: bool) -> ua.EventFilter:
    """The fields that are kept, each with the type that declares it."""
    wanted: Any = ua.EventFilter()
    wanted.SelectClauses = [
        *(
            _clause(ns0(getattr(ObjectIds, name)), [QualifiedName(0, part) for part in path.split("/")])
            for name, paths in (*_FIELDS, *(_AUDIT_FIELDS if audit else ()))
            for path in paths.split()
        ),
        _clause(ns0(ObjectIds.ConditionType), ()),
        *(_clause(own, [name]) for own in _OWN_TYPES for name in _own(space, own)),
    ]
    made: ua.EventFilter = wanted
    return made


def _own(space: AddressSpace, event_type: ua.NodeId) -> Iterator[QualifiedName]:
    """The fields that a type of the fleet declares."""
    for reference in space[event_type].references:
        if reference.IsForward and reference.ReferenceTypeId in (HAS_COMPONENT, HAS_PROPERTY):
            yield QualifiedName(reference.BrowseName.NamespaceIndex, reference.BrowseName.Name)


def _clause(event_type: ua.NodeId, path: Sequence[QualifiedName]) -> ua.SimpleAttributeOperand:
    """A field of a type; without a path the ConditionId (OPC 10000-9 5.5.2.13)."""
    clause: Any = ua.SimpleAttributeOperand()
    clause.TypeDefinitionId = event_type
    clause.BrowsePath = [ua.QualifiedName(part.name, ua.UInt16(part.namespace)) for part in path]
    clause.AttributeId = AttributeIds.Value if path else AttributeIds.NodeId
    made: ua.SimpleAttributeOperand = clause
    return made
