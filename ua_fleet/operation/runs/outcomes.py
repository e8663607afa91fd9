"""What robots and their bridges say of executions, in the words of tasks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from ua_fleet.pubsub.events import DataReceived
from ua_fleet.scenario import Value
from ua_fleet.scenario.facts import TaskOutcome
from ua_fleet.skill.executions import NOT_REACHED, ROBOT_STANDS, ExecutionReport, ExecutionState
from ua_fleet.skill.status import read_result, read_status
from ua_fleet.values import StatusCode, is_finite, status_name

__all__ = ["is_no_answer", "outcome_of", "refusal", "shown_in", "usable", "with_status"]

_BUSY: Final = (
    StatusCode.BAD_TOO_MANY_OPERATIONS,
    StatusCode.BAD_SERVER_TOO_BUSY,
    StatusCode.BAD_CONFIGURATION_ERROR,  # the bridge has been started anew, with other arguments: ask by its new words
)
"""What a robot refuses now it may take later."""
_ENDED: Final = {
    ExecutionState.DONE: TaskOutcome.DONE,
    ExecutionState.UNKNOWN: TaskOutcome.UNKNOWN,
    ExecutionState.TIMED_OUT: TaskOutcome.UNREACHED,
}


def outcome_of(state: ExecutionState, status: int) -> TaskOutcome | None:
    """What an execution has come to; None while it is under way."""
    if state is ExecutionState.REFUSED:
        return refusal(status)
    if state is not ExecutionState.FAILED:
        return _ENDED.get(state)
    if status == StatusCode.BAD_TIMEOUT:  # the driver waits no longer; nobody has seen that the robot stands
        return TaskOutcome.UNKNOWN
    if status in _BUSY:
        return TaskOutcome.BUSY
    if status in NOT_REACHED:
        return TaskOutcome.UNREACHED
    if status == StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT:
        return TaskOutcome.HALTED
    return TaskOutcome.STOPPED if status in ROBOT_STANDS else TaskOutcome.FAILED


def refusal(status: int) -> TaskOutcome:
    """What a request that was not begun has come to, by its StatusCode."""
    if status in _BUSY:
        return TaskOutcome.BUSY
    if status in NOT_REACHED:
        return TaskOutcome.UNREACHED
    if status == StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT:
        return TaskOutcome.HALTED
    return TaskOutcome.STOPPED if status in ROBOT_STANDS else TaskOutcome.REFUSED


def is_no_answer(report: ExecutionReport) -> bool:
    """Whether nobody has said anything, and not the robot's side that it cannot tell."""
    return report.state is ExecutionState.UNKNOWN and report.status == StatusCode.BAD_NO_COMMUNICATION


def with_status(message: str, status: int) -> str:
    """What people read of an end: also its StatusCode, where that says something."""
    return f"{message} ({status_name(status)})".strip() if status else message


def shown_in(event: DataReceived) -> Iterable[tuple[str, tuple[TaskOutcome | None, str, dict[str, Value]]]]:
    """The executions of a SkillStatus by their ids."""
    for said in read_status(event.metadata.fields, event.message.values):
        if said.state is ExecutionState.ASKING:
            continue  # the bridge is asking the robot: it will say
        outcome, message = outcome_of(said.state, said.status), with_status(said.message, said.status)
        yield said.execution_id.hex(), (outcome, message, usable(read_result(said.result)))


def usable(results: Mapping[str, Any]) -> dict[str, Value]:
    """The results that conditions can use; whoever sent them may have sent anything."""
    return {
        name: value
        for name, value in results.items()
        if isinstance(value, str) or (isinstance(value, bool | int | float) and is_finite(value))
    }
