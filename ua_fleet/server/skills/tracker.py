"""What is known of the executions of skills: facts in, changes of nodes and transitions out; without I/O or clock.

    requested      a request of this server was recorded, and is on its way
    concluded      its outcome: accepted, refused, timed out or unknown
    DataReceived   SkillStatus, the robot's own word, which overrules all that was assumed
    SourceSilent   what SkillStatus drives is Bad_NoCommunication, with the last values, until it is heard again

Nothing of this is coalesced or dropped. The first SkillStatus after a start shows how things are, and tells no events
of it: they were told before. An execution that this run has asked for has its events in any case.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import FleetModel, RobotModel
from ua_fleet.fleet.skills import SkillModel, argument_problem
from ua_fleet.pubsub.events import (
    DataReceived,
    SourceRefused,
    SourceReturned,
    SourceSilent,
    SubscriberEvent,
)
from ua_fleet.server.skills.program import ProgramState, Transition, path, state_of
from ua_fleet.skill.executions import OPEN, ExecutionState, Outcome, OutcomeKind, unpack
from ua_fleet.skill.status import read_result
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, LocalizedText, NodeId, StatusCode

__all__ = ["Execution", "SkillChange", "SkillKeys", "SkillTracker", "SkillTransitioned"]

MOST_REMEMBERED: Final = 64
"""Executions of one skill that are remembered after their end."""

_S: Final = ExecutionState
_STATUS: Final = {
    _S.REFUSED: int(StatusCode.BAD_REQUEST_NOT_ALLOWED),
    _S.TIMED_OUT: int(StatusCode.BAD_TIMEOUT),
    _S.FAILED: int(StatusCode.BAD_UNEXPECTED_ERROR),
    _S.UNKNOWN: int(StatusCode.UNCERTAIN),
}
"""Status of an execution, where nothing more exact was said."""
_NO_COMMUNICATION: Final = int(StatusCode.BAD_NO_COMMUNICATION)
_FLOATS: Final = (int(BuiltinType.FLOAT), int(BuiltinType.DOUBLE))


class SkillKeys(NamedTuple):
    """Addresses of a skill's nodes. The object has the numeric id, which is the Action's DataSetWriterId."""

    ns: int
    id: int

    @property
    def object(self) -> NodeId:
        """The SkillType instance."""
        return NodeId(self.ns, self.id)

    def part(self, name: str) -> NodeId:
        """A member."""
        return NodeId(self.ns, f"{self.id}.{name}")

    def result(self, name: str) -> NodeId:
        """A variable of LastResult; apart from its properties, since a result may have any name."""
        return NodeId(self.ns, f"{self.id}.Result.{name}")

    def argument(self, name: str) -> NodeId:
        """What describes an argument of Start."""
        return NodeId(self.ns, f"{self.id}.Argument.{name}")


@dataclass(frozen=True, slots=True)
class Execution:
    """One execution as it is known."""

    id: bytes
    state: ExecutionState
    status: int = StatusCode.GOOD
    message: str = ""
    progress: float = 0.0
    results: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """By name, checked against the declared types."""
    ended: int | None = None
    """Ticks, when its end was heard of."""

    @property
    def is_over(self) -> bool:
        """Whether nothing more is expected; what nobody could tell may be known later all the same."""
        return self.state not in OPEN


class SkillTransitioned(NamedTuple):
    """A skill went from one state to another, on account of an execution. Follows the changes of its nodes."""

    robot: str
    skill: SkillModel
    key: NodeId
    transition: Transition
    execution: Execution
    ticks: int


SkillChange = ValueChanged | SkillTransitioned


class _Skill:
    """One skill and its executions."""

    def __init__(self, robot: RobotModel, model: SkillModel) -> None:
        self.robot, self.model = robot.name, model
        self.keys = SkillKeys(robot.ns, model.id)
        self.executions: dict[bytes, Execution] = {}
        """In the order in which they were begun."""
        self.state = ProgramState.READY
        self.last_over: Execution | None = None
        self.shown: dict[NodeId, ValueChanged] = {}
        self.status = int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
        """What all that is driven by the robot's word has for a status."""

    @property
    def under_way(self) -> int:
        return sum(not execution.is_over for execution in self.executions.values())

    def take(self, execution: Execution, ticks: int, *, quiet: bool = False) -> list[SkillChange]:
        """A new execution, or its new state."""
        before = self.executions.get(execution.id)
        if before == execution:
            return []
        self.executions[execution.id] = execution
        if execution.is_over:
            self.last_over = execution
            self._forget()
        moves: list[Transition] = []
        if before is None or before.state != execution.state:
            was = ProgramState.READY if before is None else state_of(before.state)
            if before is None and self.state is ProgramState.HALTED:
                was = ProgramState.HALTED
            if before is None and execution.is_over:  # it began and ended between two messages
                moves += path(was, ProgramState.RUNNING)
                was = ProgramState.RUNNING
            moves += path(was, state_of(execution.state))
        latest = next(reversed(self.executions.values()))
        self.state = ProgramState.RUNNING if self.under_way else state_of(latest.state)
        changes: list[SkillChange] = [*self._show(latest, moves[-1] if moves else None, ticks)]
        if not quiet:
            changes += [
                SkillTransitioned(self.robot, self.model, self.keys.object, move, execution, ticks) for move in moves
            ]
        return changes

    def reset(self, ticks: int) -> list[SkillChange]:
        """Make a halted skill Ready."""
        latest = next(reversed(self.executions.values()), None)
        if self.state is not ProgramState.HALTED or latest is None:
            return []
        self.state = ProgramState.READY
        move = Transition.HALTED_TO_READY
        return [
            *self._show(latest, move, ticks),
            SkillTransitioned(self.robot, self.model, self.keys.object, move, latest, ticks),
        ]

    def set_status(self, status: int, ticks: int) -> list[ValueChanged]:
        """The status of all that is shown, with the last values."""
        if status == self.status:
            return []
        self.status = status
        if not self.shown:
            return self._show_idle(ticks)
        self.shown = {key: change._replace(status=status) for key, change in self.shown.items()}
        return list(self.shown.values())

    def _forget(self) -> None:
        over = [execution.id for execution in self.executions.values() if execution.is_over]
        for execution_id in over[: max(0, len(over) - MOST_REMEMBERED)]:
            del self.executions[execution_id]

    def _show_idle(self, ticks: int) -> list[ValueChanged]:
        """Nothing was ever executed, as far as anybody knows."""
        return self._put(ticks, list(self._state_values()))

    def _show(self, latest: Execution, moved: Transition | None, ticks: int) -> list[ValueChanged]:
        part = self.keys.part
        values = [
            *self._state_values(),
            (part("ExecutionId"), BuiltinType.STRING, latest.id.hex()),
            (part("Progress"), BuiltinType.DOUBLE, latest.progress),
            (part("Message"), BuiltinType.STRING, latest.message),
        ]
        if moved is not None:
            values += [
                (part("LastTransition"), BuiltinType.LOCALIZED_TEXT, LocalizedText(moved.text)),
                (part("LastTransition.Id"), BuiltinType.NODE_ID, NodeId(0, moved.node)),
                (part("LastTransition.Number"), BuiltinType.UINT32, moved.number),
                (part("LastTransition.TransitionTime"), BuiltinType.DATETIME, ticks),
            ]
        over = self.last_over
        if over is not None:
            values += [
                (part("LastStatus"), BuiltinType.STATUS_CODE, over.status),
                (part("LastResult.ExecutionId"), BuiltinType.STRING, over.id.hex()),
                (part("LastResult.EndTime"), BuiltinType.DATETIME, over.ended),
            ]
            for result in self.model.results:
                value = over.results.get(result.name)
                kind = BuiltinType(result.type) if value is not None else None
                values.append((self.keys.result(result.name), kind, value))
        return self._put(ticks, values)

    def _state_values(self) -> Iterator[tuple[NodeId, BuiltinType | None, Any]]:
        part = self.keys.part
        yield part("CurrentState"), BuiltinType.LOCALIZED_TEXT, LocalizedText(self.state.text)
        yield part("CurrentState.Id"), BuiltinType.NODE_ID, NodeId(0, self.state.node)
        yield part("CurrentState.Number"), BuiltinType.UINT32, self.state.number

    def _put(self, ticks: int, values: list[tuple[NodeId, BuiltinType | None, Any]]) -> list[ValueChanged]:
        changes: list[ValueChanged] = []
        for key, kind, value in values:
            change = ValueChanged(key, 0 if kind is None else int(kind), value, self.status, ticks, False)
            known = self.shown.get(key)
            if known is None or known._replace(source_timestamp=ticks) != change:
                self.shown[key] = change
                changes.append(change)
        return changes


class SkillTracker:
    """The skills of a fleet. Times are ticks of the wall clock."""

    def __init__(self, model: FleetModel) -> None:
        self._robots: dict[Topic, dict[str, _Skill]] = {}
        """Skills by name, by the topic of their robot's SkillStatus."""
        self._skills: dict[NodeId, _Skill] = {}
        self._topics: dict[NodeId, Topic] = {}
        self._asked: dict[bytes, _Skill] = {}
        """Executions that this run has asked for, and whose outcome is not known yet."""
        self._synchronised: set[Topic] = set()
        """Whose SkillStatus was heard."""
        self._busy: set[Topic] = set()
        """Whose robots are told to be busy."""
        self._touched: set[Topic] = set()
        for robot in model.robots:
            self.add(robot)

    def add(self, robot: RobotModel) -> None:
        """Know a robot from now on."""
        if robot.skill_status is None:
            return
        skills = self._robots.setdefault(robot.skill_status, {})
        for model in robot.skills:
            skill = skills[model.name] = _Skill(robot, model)
            self._skills[skill.keys.object] = skill
            self._topics[skill.keys.object] = robot.skill_status

    def remove(self, robot: RobotModel) -> None:
        """Forget a robot."""
        if robot.skill_status is None:
            return
        for skill in self._robots.pop(robot.skill_status, {}).values():
            del self._skills[skill.keys.object], self._topics[skill.keys.object]
        self._synchronised.discard(robot.skill_status)
        self._busy.discard(robot.skill_status)

    def knows(self, topic: Topic) -> bool:
        """Whether this is a robot's SkillStatus."""
        return topic in self._robots

    def under_way(self, key: NodeId) -> int:
        """Executions of a skill that are not over."""
        return self._skills[key].under_way

    def open_executions(self, key: NodeId) -> list[bytes]:
        """Their ids, the oldest first."""
        return [execution.id for execution in self._skills[key].executions.values() if not execution.is_over]

    def is_silent(self, key: NodeId) -> bool:
        """Whether the robot's SkillStatus was heard, and is not any more."""
        return self._skills[key].status >> 31 == 1 and self._topics[key] in self._synchronised

    def state(self, key: NodeId) -> ProgramState:
        """The state that a skill shows."""
        return self._skills[key].state

    def execution(self, key: NodeId, execution_id: bytes) -> Execution | None:
        """What is known of an execution."""
        return self._skills[key].executions.get(execution_id)

    def actions(self) -> Iterator[Topic]:
        """The Actions of all skills."""
        for status, skills in self._robots.items():
            for skill in skills.values():
                yield Topic(status.space, skill.keys.ns, skill.keys.id)

    def take_busy_changes(self) -> list[tuple[Topic, bool]]:
        """Robots, by their SkillStatus, that run skills since the last call and did not before, or the other way."""
        changes: list[tuple[Topic, bool]] = []
        for topic in self._touched:
            is_busy = any(skill.under_way for skill in self._robots.get(topic, {}).values())
            if is_busy != (topic in self._busy):
                (self._busy.add if is_busy else self._busy.discard)(topic)
                changes.append((topic, is_busy))
        self._touched.clear()
        return changes

    def requested(self, key: NodeId, execution_id: bytes, ticks: int) -> list[SkillChange]:
        """A request of this server was recorded and sent."""
        skill = self._skills[key]
        self._asked[execution_id] = skill
        self._touched.add(self._topics[key])
        return [*self._known_here(skill, ticks), *skill.take(Execution(execution_id, _S.RUNNING), ticks)]

    def concluded(self, execution_id: bytes, outcome: Outcome, ticks: int) -> list[SkillChange]:
        """The outcome of a request, also a corrected one; nothing where another run has asked for it."""
        skill = self._asked.get(execution_id)
        if skill is None:
            return []
        self._touched.add(self._topics[skill.keys.object])
        report = outcome.report
        if outcome.kind is not OutcomeKind.UNKNOWN:
            del self._asked[execution_id]
        known = skill.executions.get(execution_id)
        if known is not None and known.is_over and known.state is not _S.UNKNOWN:
            return []  # SkillStatus was faster
        execution = known or Execution(execution_id, _S.RUNNING)
        if report.state in OPEN:
            if known is not None and not known.is_over:
                return []
            return skill.take(replace(execution, state=_S.RUNNING, status=0, message=report.message, ended=None), ticks)
        is_done = report.state is _S.DONE
        return skill.take(
            replace(
                execution,
                state=report.state,
                status=report.status if is_done or report.status else _STATUS[report.state],
                message=report.message,
                progress=1.0 if is_done else execution.progress,
                results=_answered(skill.model, report.result) if is_done else {},
                ended=ticks,
            ),
            ticks,
        )

    def reset(self, key: NodeId, ticks: int) -> list[SkillChange]:
        """Make a halted skill Ready."""
        return self._skills[key].reset(ticks)

    def apply(self, event: SubscriberEvent, ticks: int) -> list[SkillChange]:
        """What an event of a robot's SkillStatus changes."""
        if isinstance(event, DataReceived):
            if (event.message.status or 0) >> 31:
                return self._all(event.topic, event.message.status or 0, ticks)
            return self._status(event, ticks)
        if isinstance(event, SourceSilent):
            return self._all(event.topic, _NO_COMMUNICATION, ticks)
        if isinstance(event, SourceReturned):
            return self._all(event.topic, 0, ticks)
        if isinstance(event, SourceRefused):
            return self._all(event.topic, int(StatusCode.BAD_SECURITY_CHECKS_FAILED), ticks)
        return []

    def _known_here(self, skill: _Skill, ticks: int) -> list[ValueChanged]:
        """What this server has asked for can be shown before the robot has said anything."""
        if skill.status == StatusCode.BAD_WAITING_FOR_INITIAL_DATA:
            return skill.set_status(0, ticks)
        return []

    def _all(self, topic: Topic, status: int, ticks: int) -> list[SkillChange]:
        skills = self._robots.get(topic, {}).values()
        return [change for skill in skills for change in skill.set_status(status, ticks)]

    def _status(self, event: DataReceived, ticks: int) -> list[SkillChange]:
        skills = self._robots.get(event.topic, {})
        changes = self._all(event.topic, 0, ticks)
        is_first = event.topic not in self._synchronised
        self._synchronised.add(event.topic)
        self._touched.add(event.topic)
        when = event.message.timestamp or ticks
        for row in _rows(event):
            skill = skills.get(str(row.get("Skill")))
            execution_id = row.get("ExecutionId")
            if skill is None or not isinstance(execution_id, bytes):
                continue
            known = skill.executions.get(execution_id)
            execution = _heard(skill.model, execution_id, row, known, when)
            if execution is not None:
                changes += skill.take(execution, when, quiet=is_first and known is None)
        return changes


def _rows(event: DataReceived) -> Iterator[dict[str, Any]]:
    """The executions of a SkillStatus, each as its fields by name."""
    names = [declared.name for declared in event.metadata.fields]
    for row in zip(*[column or () for column in event.message.values], strict=False):
        yield dict(zip(names, row, strict=True))


def _heard(
    model: SkillModel, execution_id: bytes, row: dict[str, Any], known: Execution | None, ticks: int
) -> Execution | None:
    """An execution as the robot tells it; None where that is no news, or nothing that can be."""
    try:
        state = ExecutionState(row.get("State", -1))
    except ValueError:
        return None
    message, progress = str(row.get("Message") or ""), float(row.get("Progress") or 0.0)
    if known is not None and known.is_over and known.state is not _S.UNKNOWN and state is not known.state:
        return None  # the end that was heard stays; repeats of older messages say otherwise
    if known is not None and known.state == state and known.is_over:
        return None
    is_over = state not in OPEN
    return Execution(
        execution_id,
        state,
        _STATUS.get(state, 0),
        message,
        1.0 if state is _S.DONE else progress,
        _declared(model, read_result(str(row.get("Result") or ""))) if state is _S.DONE else {},
        ticks if is_over else None,
    )


def _answered(model: SkillModel, packed: bytes) -> dict[str, Any]:
    """Results in an ActionResponse, which stand in their declared order."""
    values = [variant.value for variant in unpack(packed)]
    return _declared(model, dict(zip([result.name for result in model.results], values, strict=False)))


def _declared(model: SkillModel, given: Mapping[str, Any]) -> dict[str, Any]:
    """The results that were declared and fit their types."""
    results: dict[str, Any] = {}
    for result in model.results:
        value = given.get(result.name)
        # A result outside its range is what the robot says all the same.
        if value is None or argument_problem(replace(result, range=None), value) is not None:
            continue
        if result.type in _FLOATS:
            value = float(value)
        elif not isinstance(value, bool | str):
            value = int(value)
        results[result.name] = value
    return results
