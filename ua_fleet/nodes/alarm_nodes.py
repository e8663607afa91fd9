"""The alarms of values as nodes and events: `Fleet.Alarms` (OPC 10000-9 5.5, 5.7, 5.8).

    Server --HasEventSource--> the Variable that is watched --HasCondition--> Alarms.<id>, in the folder Fleet.Alarms

The members of an alarm are made when somebody looks at it: each has some fifty nodes, and of ten thousand alarms few
are ever looked at. So a Variable lists the alarms that are disabled, suppressed or shelved: ConditionRefresh does not
tell those of them that are inactive, and without the list a client would have to look at all. It is made when somebody
reads it, or four times a second where somebody watches it: one for each alarm that a person puts aside would take time,
and memory, by the square of their number.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from math import isinf
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.convert import node_id, raw_id, to_variant
from ua_fleet.endpoint.live import LiveValue
from ua_fleet.endpoint.node_builder import ALARM_PREFIX, HAS_COMPONENT, HAS_PROPERTY, ORGANIZES
from ua_fleet.endpoint.stack import ObjectIds, ns0
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.nodes.condition_fields import flag, node, number, status_field, string, text, time_of, two_state
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.node_factory import STANDARD, NodeFactory
from ua_fleet.nodes.projection import Projection
from ua_fleet.operation.alarms.condition import MAX_SHELVED_S, Condition, ConditionState, Shelving
from ua_fleet.operation.alarms.definitions import AlarmDefinition, AlarmKind
from ua_fleet.operation.alarms.levels import Level
from ua_fleet.values import BuiltinType, NodeId, QualifiedName, Variant, ticks_from_unix_ns

__all__ = ["ALARMS", "AlarmNodes"]

ALARMS: Final = "Fleet.Alarms"
_PUT_ASIDE: Final = f"{ALARMS}.PutAside"
_SERVER: Final = ns0(ObjectIds.Server)
_HAS_CONDITION: Final = ns0(ObjectIds.HasCondition)
_HAS_EVENT_SOURCE: Final = ns0(ObjectIds.HasEventSource)
_TWO_STATE: Final = ns0(ObjectIds.TwoStateVariableType)
_CONDITION_VARIABLE: Final = ns0(ObjectIds.ConditionVariableType)
_STATE_VARIABLE: Final = ns0(ObjectIds.FiniteStateVariableType)
_NULL: Final = NodeId(0, 0)
_TIME: Final = int(BuiltinType.DATETIME)
_CERTIFICATE_TYPE: Final = NodeId(0, int(ObjectIds.RsaSha256ApplicationCertificateType))
_DURATION: Final = ("ExpirationLimit", "UnshelveTime", "MaxTimeShelved", "OnDelay")
_TYPES: Final = {kind: int(getattr(ObjectIds, kind.value)) for kind in AlarmKind}
_LIMIT_STATES: Final = {
    Level.HIGH_HIGH: (ObjectIds.ExclusiveLimitStateMachineType_HighHigh, "HighHigh"),
    Level.HIGH: (ObjectIds.ExclusiveLimitStateMachineType_High, "High"),
    Level.LOW: (ObjectIds.ExclusiveLimitStateMachineType_Low, "Low"),
    Level.LOW_LOW: (ObjectIds.ExclusiveLimitStateMachineType_LowLow, "LowLow"),
}
_SHELVING_STATES: Final = {
    Shelving.UNSHELVED: ObjectIds.ShelvedStateMachineType_Unshelved,
    Shelving.TIMED: ObjectIds.ShelvedStateMachineType_TimedShelved,
    Shelving.ONE_SHOT: ObjectIds.ShelvedStateMachineType_OneShotShelved,
}
SHELVING_METHODS: Final = tuple(
    ns0(method)
    for method in (
        ObjectIds.ShelvedStateMachineType_Unshelve,
        ObjectIds.ShelvedStateMachineType_OneShotShelve,
        ObjectIds.ShelvedStateMachineType_TimedShelve,
    )
)
_MACHINES: Final = {
    "ShelvingState": ns0(ObjectIds.ShelvedStateMachineType),
    "LimitState": ns0(ObjectIds.ExclusiveLimitStateMachineType),
}
_METHODS: Final = (
    ObjectIds.ConditionType_Enable,
    ObjectIds.ConditionType_Disable,
    ObjectIds.ConditionType_AddComment,
    ObjectIds.AcknowledgeableConditionType_Acknowledge,
    ObjectIds.AlarmConditionType_Suppress,
    ObjectIds.AlarmConditionType_Unsuppress,
)


def ticks_of(wall_s: float) -> int:
    """Seconds of the wall clock as ticks."""
    return ticks_from_unix_ns(round(wall_s * 1e9))


class AlarmNodes:
    """Shows alarms, and makes their events."""

    def __init__(self, parts: NodeFactory, events: ServerEvents, projection: Projection) -> None:
        """Prepare to show alarms of a fleet; `build` makes the folder."""
        self._parts, self._events, self._projection = parts, events, projection
        self._shown: dict[NodeId, Condition] = {}
        self._made: dict[str, dict[str, Variant]] = {}
        """What members show, by the alarm's id; of those that somebody has looked at."""
        self._put_aside: dict[str, None] = {}
        """Ids of alarms that are disabled, suppressed or shelved."""
        self._listed: list[str] | None = None
        """The same as they were read last; None where there was a change since."""
        self._list = LiveValue(self._ids, ua.VariantType.String)

    def build(self) -> None:
        """Make the folder, and the list of what is put aside."""
        parts = self._parts
        name = QualifiedName(parts.ns, "Alarms")
        parts.builder.add_object(parts.id(ALARMS), name, parts.id("Fleet"), STANDARD["FolderType"])
        parts.builder.add_variable(
            parts.id(_PUT_ASIDE),
            QualifiedName(parts.ns, "PutAside"),
            parts.id(ALARMS),
            STANDARD["PropertyType"],
            data_type=raw_id(int(BuiltinType.STRING)),
            value=self._list,
            value_rank=1,
            reference=HAS_PROPERTY,
        )

    async def tell(self) -> None:
        """Tell who watches the list of its changes."""
        await self._list.tell()

    def add(self, condition: Condition) -> None:
        """Show an alarm: the node that it is about has to be there."""
        parts, definition = self._parts, condition.definition
        key = self.key(definition)
        made = node_id(key)
        parts.builder.add_object(
            made,
            QualifiedName(parts.ns, definition.id),
            parts.id(ALARMS),
            ns0(_TYPES[definition.kind]),
            reference=ORGANIZES,
        )
        source = node_id(definition.source)
        parts.builder.add_reference(source, _HAS_CONDITION, made)
        if source != _SERVER and not parts.builder.is_referenced(source, _HAS_EVENT_SOURCE):
            parts.builder.add_reference(_SERVER, _HAS_EVENT_SOURCE, source)
        parts.builder.add_later(made, partial(self._make, condition))
        self._shown[key] = condition
        self._put(definition, condition.state)

    def key(self, definition: AlarmDefinition) -> NodeId:
        """The ConditionId of an alarm."""
        return NodeId(self._parts.ns, f"{ALARM_PREFIX}{definition.id}")

    def condition_of(self, owner: ua.NodeId) -> Condition | None:
        """The alarm of an Object that Methods are called of: itself, or its ShelvingState."""
        identifier: Any = owner.Identifier
        if isinstance(identifier, str):
            identifier = identifier.removesuffix(".ShelvingState")
        return self._shown.get(NodeId(int(owner.NamespaceIndex), identifier))

    def notify(self, definition: AlarmDefinition, state: ConditionState) -> None:
        """Tell of a notification, in order with all values, and show it."""
        fields = self._fields(definition, state)
        self._put(definition, state)
        self._show(definition, fields)
        self._projection.then(partial(self._emit, definition, state, fields))

    def refresh(self, subscription_id: int, item_id: int | None) -> Iterator[None]:
        """Tell one subscription, or one of its items, what is retained, a step for each alarm."""
        for condition in list(self._shown.values()):
            yield
            if condition.state.retain and condition.state.event_id:
                fields = self._fields(condition.definition, condition.state)
                self._emit(condition.definition, condition.state, fields, subscription_id, item_id)

    # Within.

    def _put(self, definition: AlarmDefinition, state: ConditionState) -> None:
        """Have an alarm in the list of those that are put aside, or not."""
        if state.is_put_aside is (definition.id in self._put_aside):
            return
        if state.is_put_aside:
            self._put_aside[definition.id] = None
        else:
            del self._put_aside[definition.id]
        self._listed = None

    def _ids(self) -> list[str]:
        """The list of those that are put aside, another one after each change."""
        if self._listed is None:
            self._listed = list(self._put_aside)
        return self._listed

    def _emit(
        self,
        definition: AlarmDefinition,
        state: ConditionState,
        fields: dict[str, Variant],
        subscription_id: int | None = None,
        item_id: int | None = None,
    ) -> None:
        self._events.emit(
            ns0(_TYPES[definition.kind]),
            source=definition.source,
            source_name=definition.source_name,
            message=state.message,
            severity=max(state.severity, 1),
            ticks=ticks_of(state.told_at),
            fields={"NodeId": node(self.key(definition)), **fields},
            subscription_id=subscription_id,
            item_id=item_id,
        )

    def _show(self, definition: AlarmDefinition, fields: dict[str, Variant]) -> None:
        shown = self._made.get(definition.id)
        if shown is None:
            return
        ticks = fields["Time"].value
        for name, variant in fields.items():
            if shown.get(name) != variant:
                shown[name] = variant
                self._projection.write(
                    ValueChanged(self._member(definition, name), variant.type, variant.value, 0, ticks, False)
                )

    def _member(self, definition: AlarmDefinition, name: str) -> NodeId:
        return NodeId(self._parts.ns, f"{ALARM_PREFIX}{definition.id}.{name.replace('/', '.')}")

    def _make(self, condition: Condition, owner: ua.NodeId) -> None:
        """Make the members of an alarm, as it is now."""
        definition, builder = condition.definition, self._parts.builder
        fields = self._fields(definition, condition.state)
        self._made[definition.id] = dict(fields)
        for machine in dict.fromkeys(name.partition("/")[0] for name in fields):
            if machine in _MACHINES:
                made = node_id(self._member(definition, machine))
                builder.add_object(made, QualifiedName(0, machine), owner, _MACHINES[machine])
                for method in SHELVING_METHODS if machine == "ShelvingState" else ():
                    builder.add_reference(made, HAS_COMPONENT, method)
        for name in sorted(fields, key=lambda name: name.count("/")):
            self._make_member(definition, owner, name, fields[name])
        methods = [*_METHODS]
        if definition.needs_confirmation:
            methods.append(ObjectIds.AcknowledgeableConditionType_Confirm)
        for shared in methods:
            builder.add_reference(owner, HAS_COMPONENT, ns0(shared))

    def _make_member(self, definition: AlarmDefinition, owner: ua.NodeId, name: str, value: Variant) -> None:
        above, _, member = name.rpartition("/")
        parent = node_id(self._member(definition, above)) if above else owner
        kind, reference = STANDARD["PropertyType"], HAS_PROPERTY
        if member in ("CurrentState",):
            kind, reference = _STATE_VARIABLE, HAS_COMPONENT
        elif member.endswith("State") and member != "NormalState":
            kind, reference = _TWO_STATE, HAS_COMPONENT
        elif member in ("Quality", "LastSeverity", "Comment"):
            kind, reference = _CONDITION_VARIABLE, HAS_COMPONENT
        data_type = raw_id(value.type & 0x3F)
        if value.type == _TIME:
            data_type = STANDARD["UtcTime"]
        elif member in _DURATION:
            data_type = STANDARD["Duration"]
        key = self._member(definition, name)
        self._parts.values[key] = self._parts.builder.add_variable(
            node_id(key),
            QualifiedName(0, member),
            parent,
            kind,
            data_type=data_type,
            value=ua.DataValue(to_variant(value.type, value.value)),
            reference=reference,
        )

    def _fields(self, definition: AlarmDefinition, state: ConditionState) -> dict[str, Variant]:
        """The fields of an alarm's event, and the values of its members."""
        return {**dict(_common(definition, state)), **dict(_of_kind(definition, state))}


def _common(definition: AlarmDefinition, state: ConditionState) -> Iterator[tuple[str, Variant]]:
    told = ticks_of(state.told_at)
    severity = max(state.severity, 1)
    is_process = definition.watched is not None and definition.kind is AlarmKind.LEVEL
    condition_class = "ProcessConditionClass" if is_process else "SystemConditionClass"
    class_id = NodeId(0, int(getattr(ObjectIds, f"{condition_class}Type")))
    yield "EventId", Variant(int(BuiltinType.BYTE_STRING), state.event_id)
    yield "EventType", node(NodeId(0, _TYPES[definition.kind]))
    yield "SourceNode", node(definition.source)
    yield "SourceName", string(definition.source_name)
    yield "Time", time_of(told)
    yield "ReceiveTime", time_of(told)
    yield "Message", text(state.message)
    yield "Severity", number(BuiltinType.UINT16, severity)
    yield "ConditionClassId", node(class_id)
    yield "ConditionClassName", text(condition_class)
    yield "ConditionName", string(definition.id)
    yield "BranchId", node(_NULL)
    yield "Retain", flag(state.retain)
    yield from two_state("EnabledState", state.enabled, "Enabled", "Disabled")
    yield from status_field("Quality", number(BuiltinType.STATUS_CODE, state.quality), told)
    last = number(BuiltinType.UINT16, max(state.last_severity, 1))
    yield from status_field("LastSeverity", last, told)
    commented = None if state.comment_at is None else ticks_of(state.comment_at)
    yield from status_field("Comment", text(state.comment), commented)
    yield "ClientUserId", string(state.comment_by)
    yield from two_state("AckedState", state.acked, "Acknowledged", "Unacknowledged")
    if definition.needs_confirmation:
        yield from two_state("ConfirmedState", state.confirmed, "Confirmed", "Unconfirmed")
    yield from two_state("ActiveState", state.active, "Active", "Inactive")
    yield "ActiveState/TransitionTime", time_of(ticks_of(state.since))
    yield "InputNode", node(definition.watched or _NULL)
    yield from two_state("SuppressedState", state.suppressed, "Suppressed", "Unsuppressed")
    yield "SuppressedOrShelved", flag(state.suppressed_or_shelved)
    yield "ShelvingState/CurrentState", text(state.shelving.value)
    yield "ShelvingState/CurrentState/Id", node(NodeId(0, int(_SHELVING_STATES[state.shelving])))
    left_s = 0.0 if state.unshelve_at is None else max(state.unshelve_at - state.told_at, 0.0)
    yield "ShelvingState/UnshelveTime", number(BuiltinType.DOUBLE, left_s * 1000)
    yield "MaxTimeShelved", number(BuiltinType.DOUBLE, MAX_SHELVED_S * 1000)
    if definition.delay_s:
        yield "OnDelay", number(BuiltinType.DOUBLE, definition.delay_s * 1000)


def _of_kind(definition: AlarmDefinition, state: ConditionState) -> Iterable[tuple[str, Variant]]:
    if definition.kind is not AlarmKind.LEVEL:
        yield "NormalState", node(_NULL)
        if (certificate := definition.certificate) is not None:
            yield "ExpirationDate", time_of(ticks_of(certificate.expires_at))
            yield "ExpirationLimit", number(BuiltinType.DOUBLE, certificate.limit_s * 1000)
            yield "CertificateType", node(_CERTIFICATE_TYPE)
            yield "Certificate", Variant(int(BuiltinType.BYTE_STRING), certificate.der)
        return
    levels = definition.levels
    state_id, name = _LIMIT_STATES.get(Level(state.level), (0, ""))
    yield "LimitState/CurrentState", text(name)
    yield "LimitState/CurrentState/Id", node(NodeId(0, int(state_id)))
    for member, limit in (
        ("HighHighLimit", levels.high_high),
        ("HighLimit", levels.high),
        ("LowLimit", levels.low),
        ("LowLowLimit", levels.low_low),
    ):
        if not isinf(limit):
            yield member, number(BuiltinType.DOUBLE, limit)
