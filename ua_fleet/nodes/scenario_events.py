"""What happens to runs, steps and decisions as events: which type, about which node, with which fields."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from ua_fleet.nodes.nodeset import TypeId
from ua_fleet.nodes.scenario_nodes import ranking_values
from ua_fleet.operation.runs.records import DecisionRecord, RunRecord
from ua_fleet.orchestrator import DecisionChanged, HoldChanged, OperatorAsked
from ua_fleet.scenario.facts import (
    AdoptionTold,
    Fact,
    Replaced,
    ReplacementWanted,
    RobotReturned,
    RunAdopted,
    RunCarried,
    RunClosing,
    RunCreated,
    RunEnded,
    RunOutcome,
    RunPaused,
    RunResumed,
    StepEnded,
    StepState,
    TaskOutcome,
    TaskOver,
    encode_fact,
)
from ua_fleet.values import BuiltinType, Variant

__all__ = ["Told", "decision_event", "fact_event", "hold_event", "question_event"]

_STRING: Final = int(BuiltinType.STRING)
_USUAL, _NOTABLE, _GRAVE = 100, 500, 700
_RUN_FACTS: Final = (
    RunCreated,
    RunCarried,
    RunAdopted,
    AdoptionTold,
    RunPaused,
    RunResumed,
    RunClosing,
    RunEnded,
)


class Told(NamedTuple):
    """An event to be emitted."""

    kind: TypeId
    message: str
    severity: int
    fields: dict[str, Variant]


def fact_event(record: RunRecord, fact: Fact) -> Told:
    """The event of a fact of a run that the record has taken in."""
    fields = _of_run(record)
    name = f"{record.scenario} {record.run_id}"
    if isinstance(fact, _RUN_FACTS):
        reason = getattr(fact, "reason", "")
        message = f"{name}: {record.shown_state}" + (f": {reason}" if reason else "")
        failed = isinstance(fact, RunEnded) and fact.outcome is not RunOutcome.DONE
        return Told(TypeId.RUN_EVENT, message, _GRAVE if failed else _USUAL, fields)
    step: str = getattr(fact, "step", "")
    task = record.state.tasks.get(step)
    outcome: Any = getattr(fact, "outcome", getattr(fact, "state", ""))
    robot: str = getattr(fact, "robot", "") or (task.robot if task is not None else "")
    values = {
        "Fact": type(fact).__name__,
        "Step": step,
        "Task": task.name if task is not None else "",
        "Robot": robot,
        "Skill": task.skill if task is not None else "",
        "Outcome": str(outcome),
        "Detail": encode_fact(fact),
    }
    fields |= {field: Variant(_STRING, value) for field, value in values.items()}
    who = (task.name if task is not None else "") or step
    words = [
        type(fact).__name__,
        who,
        robot,
        str(outcome),
        str(getattr(fact, "message", "") or getattr(fact, "reason", "")),
    ]
    message = f"{name}: {' '.join(word for word in words if word)}"
    return Told(TypeId.STEP_EVENT, message, _severity(fact), fields)


def question_event(record: RunRecord, asked: OperatorAsked) -> Told:
    """Somebody has to say what became of a task."""
    values = {
        "Fact": "OperatorAsked",
        "Step": asked.step,
        "Task": asked.task,
        "Robot": asked.robot,
        "Skill": asked.skill,
        "Outcome": "",
        "Detail": asked.question,
    }
    fields = _of_run(record) | {field: Variant(_STRING, value) for field, value in values.items()}
    return Told(TypeId.STEP_EVENT, f"{record.scenario} {record.run_id}: {asked.question}", _GRAVE, fields)


def decision_event(record: RunRecord, decision: DecisionRecord, changed: DecisionChanged) -> Told:
    """A ranking, a choice, or the end of looking for one."""
    values = {
        "DecisionId": decision.id,
        "DecisionState": decision.state,
        "Task": decision.task,
        "Failed": decision.failed,
        "Reason": decision.reason,
        "Chosen": decision.chosen,
        "ChosenBy": decision.by,
    }
    fields = _of_run(record) | {field: Variant(_STRING, value) for field, value in values.items()}
    fields |= ranking_values(decision.ranking)
    about = f"{record.scenario} {record.run_id}: {decision.task}"
    if decision.state == "chosen":
        message = f"{about}: {decision.chosen} takes over from {decision.failed or 'nobody'}, chosen by {decision.by}"
    elif decision.state == "aborted":
        message = f"{about}: nobody takes over: {decision.reason}"
    else:
        ranked = decision.ranking.ranked if decision.ranking is not None else ()
        order = ", ".join(f"{place.robot} {place.score:.3f}" for place in ranked) or "no candidate"
        message = f"{about}: who takes over from {changed.failed or 'nobody'} ({changed.reason})? {order}"
    return Told(TypeId.DECISION_EVENT, message, _GRAVE if decision.state != "chosen" else _NOTABLE, fields)


def hold_event(changed: HoldChanged) -> Told:
    """A robot is held back from tasks, or released."""
    hold = changed.hold
    fields = {
        "Robot": Variant(_STRING, hold.robot),
        "Held": Variant(int(BuiltinType.BOOLEAN), changed.is_held),
        "By": Variant(_STRING, changed.by),
        "Reason": Variant(_STRING, hold.reason),
    }
    message = hold.told if changed.is_held else f"{hold.robot} is released by {changed.by}, and may have tasks again"
    return Told(TypeId.ROBOT_HOLD_EVENT, message, _NOTABLE if changed.is_held else _USUAL, fields)


def _of_run(record: RunRecord) -> dict[str, Variant]:
    values = {"RunId": record.run_id, "Scenario": record.scenario, "State": record.shown_state}
    return {field: Variant(_STRING, value) for field, value in values.items()}


def _severity(fact: Fact) -> int:
    match fact:
        case TaskOver(outcome=outcome):
            return _USUAL if outcome in (TaskOutcome.DONE, TaskOutcome.BUSY) else _GRAVE
        case StepEnded(state=StepState.FAILED):
            return _GRAVE
        case Replaced() | ReplacementWanted() | RobotReturned():
            return _NOTABLE
        case _:
            return _USUAL
