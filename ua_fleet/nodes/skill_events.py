"""Transitions of skills as events."""

from __future__ import annotations

from typing import Final

from ua_fleet.endpoint.convert import raw_id
from ua_fleet.nodes.events import EventFields, ServerEvents
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId
from ua_fleet.operation.skills.tracker import SkillTransitioned
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.values import ARRAY, BuiltinType, LocalizedText, NodeId, Variant

__all__ = ["fields_of", "tell_transition"]

_TYPE: Final = raw_id(TypeId.SKILL_TRANSITION_EVENT.value, TYPES_INDEX)
_SEVERITY: Final = {ExecutionState.FAILED: 600, ExecutionState.UNKNOWN: 700, ExecutionState.REFUSED: 400}
"""Where somebody has to look; all else is 100."""


def tell_transition(events: ServerEvents, moved: SkillTransitioned) -> None:
    """Emit the event of a transition."""
    execution, name = moved.execution, f"{moved.robot}.{moved.skill.name}"
    message = f"{name}: {moved.transition.text}"
    events.emit(
        _TYPE,
        source=moved.key,
        source_name=name,
        message=f"{message}; {execution.message}" if execution.message else message,
        severity=_SEVERITY.get(execution.state, 100),
        ticks=moved.ticks,
        fields=fields_of(moved),
    )


def fields_of(moved: SkillTransitioned) -> EventFields:
    """The fields of SkillTransitionEventType and of TransitionEventType."""
    before, after = moved.transition.ends
    execution = moved.execution
    results = [
        Variant(result.type, execution.results[result.name])
        for result in moved.skill.results
        if result.name in execution.results
    ]
    names = tuple(name for name in (result.name for result in moved.skill.results) if name in execution.results)
    return {
        "Transition": _text(moved.transition.text),
        "Transition/Id": _node(moved.transition.node),
        "Transition/Number": Variant(int(BuiltinType.UINT32), moved.transition.number),
        "FromState": _text(before.text),
        "FromState/Id": _node(before.node),
        "FromState/Number": Variant(int(BuiltinType.UINT32), before.number),
        "ToState": _text(after.text),
        "ToState/Id": _node(after.node),
        "ToState/Number": Variant(int(BuiltinType.UINT32), after.number),
        "IntermediateResult": Variant(0, None),
        "Robot": Variant(int(BuiltinType.STRING), moved.robot),
        "Skill": Variant(int(BuiltinType.STRING), moved.skill.name),
        "ExecutionId": Variant(int(BuiltinType.STRING), execution.id.hex()),
        "IsOver": Variant(int(BuiltinType.BOOLEAN), execution.is_over),
        "Status": Variant(int(BuiltinType.STATUS_CODE), execution.status),
        "ResultNames": Variant(int(BuiltinType.STRING | ARRAY), names),
        "Results": Variant(int(BuiltinType.VARIANT | ARRAY), tuple(results)),
    }


def _text(text: str) -> Variant:
    return Variant(int(BuiltinType.LOCALIZED_TEXT), LocalizedText(text))


def _node(identifier: int) -> Variant:
    return Variant(int(BuiltinType.NODE_ID), NodeId(0, identifier))
