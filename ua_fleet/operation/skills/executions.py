"""Executions as the server knows them, and how they are read from what robots say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

from ua_fleet.fleet.skills import SkillModel, argument_problem
from ua_fleet.skill.executions import OPEN, ExecutionState, RequestOutcome, named_results
from ua_fleet.skill.status import ExecutionStatus, read_result
from ua_fleet.values import BuiltinType, NodeId, Quality, StatusCode, quality_of

__all__ = ["STATUS_OF", "KnownExecution", "SkillKeys", "answered", "heard"]

_S: Final = ExecutionState
STATUS_OF: Final = {
    _S.REFUSED: int(StatusCode.BAD_REQUEST_NOT_ALLOWED),
    _S.TIMED_OUT: int(StatusCode.BAD_TIMEOUT),
    _S.FAILED: int(StatusCode.BAD_UNEXPECTED_ERROR),
    _S.UNKNOWN: int(StatusCode.UNCERTAIN),
}
"""Status of an execution, where nothing more exact was said."""
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
class KnownExecution:
    """One execution as it is known."""

    id: bytes
    state: ExecutionState
    status: int = StatusCode.GOOD
    message: str = ""
    progress: float = 0.0
    results: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """By name, checked against the declared types."""
    began: int = 0
    """Ticks, when it was asked for or first heard of."""
    ended: int | None = None
    """Ticks, when its end was heard of."""

    @property
    def is_over(self) -> bool:
        """Whether nothing more is expected; what nobody could tell may be known later all the same."""
        return self.state not in OPEN


def heard(model: SkillModel, said: ExecutionStatus, known: KnownExecution | None, ticks: int) -> KnownExecution | None:
    """An execution as the robot tells it; None where that is no news, or cannot be."""
    state = said.state
    if known is not None and (known.state, state) == (_S.SUSPENDED, _S.ASKING):
        state = _S.SUSPENDED  # its bridge was started anew; nothing says that the robot goes on
    if known is not None and known.is_over and known.state is not _S.UNKNOWN and state is not known.state:
        return None  # the end that was heard stays; repeats of older messages say otherwise
    if known is not None and known.state == state and known.is_over:
        return None
    is_over = state not in OPEN
    return KnownExecution(
        said.execution_id,
        state,
        _end_status(state, said.status),
        said.message,
        1.0 if state is _S.DONE else said.progress,
        _declared(model, read_result(said.result)) if state is _S.DONE else {},
        known.began if known is not None else ticks,
        ticks if is_over else None,
    )


def _end_status(state: ExecutionState, said: int) -> int:
    """The StatusCode of an execution: what was said, where it is of the quality that the state has."""
    usual = STATUS_OF.get(state, 0)
    if state is _S.DONE:
        return 0 if quality_of(said) is Quality.BAD else said
    return said if usual and quality_of(said) is quality_of(usual) else usual


def answered(model: SkillModel, outcome: RequestOutcome) -> dict[str, Any]:
    """Results in an ActionResponse, by the names that its bridge announces."""
    return _declared(model, named_results(outcome, [result.name for result in model.results]))


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
