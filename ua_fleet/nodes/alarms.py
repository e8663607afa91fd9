"""A fault as an alarm: the fields of OffNormalAlarmType and its supertypes (OPC 10000-9 5.5, 5.7, 5.8)."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from typing import Final, NamedTuple

from asyncua.ua.object_ids import ObjectIds

from ua_fleet.endpoint.stack import ns0
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId
from ua_fleet.orchestrator import Fault
from ua_fleet.orchestrator.faults import BY_PERSON
from ua_fleet.values import ARRAY, BuiltinType, LocalizedText, NodeId, Variant

__all__ = [
    "ACKNOWLEDGE",
    "ADD_COMMENT",
    "DISABLE",
    "ENABLE",
    "SHARED_METHODS",
    "Comment",
    "alarm_fields",
    "alarm_message",
    "severity_of",
]

ACKNOWLEDGE: Final = ns0(ObjectIds.AcknowledgeableConditionType_Acknowledge)
ADD_COMMENT: Final = ns0(ObjectIds.ConditionType_AddComment)
ENABLE: Final = ns0(ObjectIds.ConditionType_Enable)
DISABLE: Final = ns0(ObjectIds.ConditionType_Disable)
SHARED_METHODS: Final = (ACKNOWLEDGE, ADD_COMMENT, ENABLE, DISABLE)
"""Methods of the type, which all alarms share (OPC 10000-3 6.4.4.2)."""

_SEVERITY: Final = {"announced": 800, "robot": 800, "silent": 700, "skill": 700}
"""Of faults that the program finds itself; conditions have 500."""
_NULL: Final = NodeId(0, 0)


class Comment(NamedTuple):
    """What somebody has said of a fault."""

    text: str = ""
    by: str = ""
    ticks: int | None = None


def severity_of(fault: Fault) -> int:
    """1 to 1000."""
    return _SEVERITY.get(fault.source, 500)


def alarm_message(fault: Fault) -> str:
    """One line for people."""
    lacks = f" lacks {', '.join(fault.capacities)}" if fault.capacities else ""
    if not fault.active:
        return f"{fault.robot}: over: {fault.reason}"
    cure = f"; {fault.cure}" if fault.source in BY_PERSON else ""
    return f"{fault.robot}{lacks}: {fault.reason}{cure}"


def alarm_fields(
    fault: Fault, condition: NodeId, event_id: bytes, comment: Comment, ticks: int, since: int
) -> dict[str, Variant]:
    """The fields of a fault's event, and the values of its node; `since` it is active, or is not any more."""
    acknowledged = "Acknowledged" if fault.acknowledged else "Unacknowledged"
    return {
        "NodeId": Variant(int(BuiltinType.NODE_ID), condition),  # ConditionId, OPC 10000-9 5.5.2.13
        "EventId": Variant(int(BuiltinType.BYTE_STRING), event_id),
        "EventType": Variant(int(BuiltinType.NODE_ID), NodeId(TYPES_INDEX, TypeId.FAULT_ALARM.value)),
        "SourceNode": Variant(int(BuiltinType.NODE_ID), NodeId(condition.namespace, f"Robots.{fault.robot}")),
        "SourceName": _string(fault.robot),
        "ReceiveTime": _time(ticks),
        "ConditionClassId": Variant(int(BuiltinType.NODE_ID), NodeId(0, int(ObjectIds.SystemConditionClassType))),
        "ConditionClassName": _text("SystemConditionClass"),
        "ConditionName": _string(fault.id),
        "BranchId": Variant(int(BuiltinType.NODE_ID), _NULL),
        "Retain": _flag(fault.active or not fault.acknowledged),
        "EnabledState": _text("Enabled"),
        "EnabledState/Id": _flag(True),
        "Quality": Variant(int(BuiltinType.STATUS_CODE), 0),
        "Quality/SourceTimestamp": _time(ticks),
        "LastSeverity": Variant(int(BuiltinType.UINT16), severity_of(fault)),
        "LastSeverity/SourceTimestamp": _time(ticks),
        "Comment": _text(comment.text),
        "Comment/SourceTimestamp": _time(comment.ticks),
        "ClientUserId": _string(comment.by or fault.acknowledged_by),
        "AckedState": _text(acknowledged),
        "AckedState/Id": _flag(fault.acknowledged),
        "ActiveState": _text("Active" if fault.active else "Inactive"),
        "ActiveState/Id": _flag(fault.active),
        "ActiveState/TransitionTime": _time(since),
        "InputNode": Variant(int(BuiltinType.NODE_ID), _NULL),
        "SuppressedOrShelved": _flag(False),
        "NormalState": Variant(int(BuiltinType.NODE_ID), _NULL),
        "Severity": Variant(int(BuiltinType.UINT16), severity_of(fault)),
        "Message": _text(alarm_message(fault)),
        "Time": _time(ticks),
        "Robot": _string(fault.robot),
        "FaultSource": _string(fault.source),
        "Reason": _string(fault.reason),
        "Capacities": Variant(int(BuiltinType.STRING | ARRAY), fault.capacities),
    }


def _text(text: str) -> Variant:
    return Variant(int(BuiltinType.LOCALIZED_TEXT), LocalizedText(text))


def _string(text: str) -> Variant:
    return Variant(int(BuiltinType.STRING), text)


def _flag(value: bool) -> Variant:
    return Variant(int(BuiltinType.BOOLEAN), value)


def _time(ticks: int | None) -> Variant:
    return Variant(int(BuiltinType.DATETIME), ticks)
