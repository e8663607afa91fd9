"""One skill: its executions, its state, and what its nodes show of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final, NamedTuple

from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import RobotModel
from ua_fleet.fleet.skills import SkillModel
from ua_fleet.operation.skills.executions import KnownExecution, SkillKeys
from ua_fleet.operation.skills.program import ProgramState, Transition, path, state_of
from ua_fleet.skill.executions import OPEN, ExecutionState
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType, LocalizedText, NodeId, StatusCode

__all__ = ["SkillChange", "SkillTransitioned", "TrackedSkill"]

MOST_REMEMBERED: Final = 64
"""Executions of one skill that are remembered after their end."""
GRACE_S: Final = 10.0
"""So long after its timeout the end of an execution is waited for."""
_S: Final = ExecutionState


class SkillTransitioned(NamedTuple):
    """A skill went from one state to another, on account of an execution. Follows the changes of its nodes."""

    robot: str
    skill: SkillModel
    key: NodeId
    transition: Transition
    execution: KnownExecution
    ticks: int


SkillChange = ValueChanged | SkillTransitioned


class TrackedSkill:
    """One skill and its executions."""

    def __init__(self, robot: RobotModel, model: SkillModel) -> None:
        self.robot, self.model = robot.name, model
        self.keys = SkillKeys(robot.ns, model.id)
        self.executions: dict[bytes, KnownExecution] = {}
        """In the order in which they were begun."""
        self.listed: frozenset[bytes] = frozenset()
        """Executions that the robot's last SkillStatus tells of."""
        self.state = ProgramState.READY
        self.last_over: KnownExecution | None = None
        self.shown: dict[NodeId, ValueChanged] = {}
        self.status = int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
        """What all that is driven by the robot's word has for a status."""

    @property
    def under_way(self) -> int:
        """Executions that are not over."""
        return len(self.ids(OPEN))

    def ids(self, states: frozenset[ExecutionState]) -> list[bytes]:
        """The executions in one of these states, the oldest first."""
        return [execution.id for execution in self.executions.values() if execution.state in states]

    def _state(self) -> ProgramState:
        """Suspended where the robot stands in all that is under way."""
        if not self.under_way:
            return state_of(next(reversed(self.executions.values())).state)
        return ProgramState.RUNNING if self.ids(OPEN - {_S.SUSPENDED}) else ProgramState.SUSPENDED

    def take(self, execution: KnownExecution, ticks: int, *, quiet: bool = False) -> list[SkillChange]:
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
        self.state = self._state()
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

    def expire(self, ticks: int) -> list[SkillChange]:
        """Give up what the robot no longer tells of, long after its time: its end was lost."""
        patience = round((self.model.timeout_s + GRACE_S) * TICKS_PER_SECOND)
        changes: list[SkillChange] = []
        for execution in list(self.executions.values()):
            if not execution.is_over and execution.id not in self.listed and execution.began + patience < ticks:
                said = "its end was not reported; see what the robot does"
                status = int(StatusCode.UNCERTAIN)
                gone = replace(execution, state=_S.UNKNOWN, status=status, message=said, ended=ticks)
                changes += self.take(gone, ticks)
        return changes

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

    def _show(self, latest: KnownExecution, moved: Transition | None, ticks: int) -> list[ValueChanged]:
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
