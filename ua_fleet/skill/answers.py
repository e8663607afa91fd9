"""What an ActionResponse says of an execution: a Report as the fields of a message, and back.

Our responses have two fields before the results of the skill: the ExecutionState as a Byte and a line for people as a
String; the Status of the DataSetMessage header has the StatusCode. Of a foreign responder, whose responses have no such
fields, the Status alone tells: Good is done, Uncertain is unknown, Bad_Timeout is timed out, and all else was refused.
"""

from __future__ import annotations

from typing import Any, Final

from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome, pack, unpack
from ua_fleet.values import BuiltinType, Quality, StatusCode, quality_of
from ua_fleet.wire.actions import ActionMessage

__all__ = ["answer_fields", "outcome_of", "read_answer"]

LEADING_TYPES: Final = (BuiltinType.BYTE.value, BuiltinType.STRING.value)
_NEVER_SAID: Final = frozenset({ExecutionState.ASKING, ExecutionState.SUSPENDED})
_SAID: Final = frozenset(ExecutionState) - _NEVER_SAID
_UPPER_BITS: Final = 0xFFFF_0000

_KINDS: Final = {
    ExecutionState.REFUSED: OutcomeKind.REFUSED,
    ExecutionState.TIMED_OUT: OutcomeKind.TIMED_OUT,
    ExecutionState.RUNNING: OutcomeKind.ACCEPTED,
    ExecutionState.DONE: OutcomeKind.ACCEPTED,
    ExecutionState.FAILED: OutcomeKind.ACCEPTED,
    ExecutionState.UNKNOWN: OutcomeKind.UNKNOWN,
    ExecutionState.ASKING: OutcomeKind.UNKNOWN,
    ExecutionState.SUSPENDED: OutcomeKind.ACCEPTED,
}


def answer_fields(report: ExecutionReport) -> tuple[tuple[int, ...], tuple[Any, ...]]:
    """Types and values of a response that says this. Of what is suspended it says Running: it was accepted."""
    results = unpack(report.result)
    # A requestor that does not know the state would take the Good status for the end.
    state = ExecutionState.RUNNING if report.state is ExecutionState.SUSPENDED else report.state
    return (
        (*LEADING_TYPES, *[result.type for result in results]),
        (state.value, report.message, *[result.value for result in results]),
    )


def read_answer(message: ActionMessage) -> ExecutionReport:
    """What a response says."""
    status = (message.status or 0) & _UPPER_BITS
    if message.types[:2] == LEADING_TYPES and message.values[0] in _SAID:
        state = ExecutionState(message.values[0])
        return ExecutionReport(state, status, message.values[1] or "", pack(message.types[2:], message.values[2:]))
    return ExecutionReport(_state_of(status), status, "", pack(message.types, message.values))


def _state_of(status: int) -> ExecutionState:
    quality = quality_of(status)
    if quality is Quality.GOOD:
        return ExecutionState.DONE
    if quality is Quality.UNCERTAIN:
        return ExecutionState.UNKNOWN
    return ExecutionState.TIMED_OUT if status == StatusCode.BAD_TIMEOUT else ExecutionState.REFUSED


def outcome_of(report: ExecutionReport) -> RequestOutcome:
    """What a requestor knows once it was told this."""
    return RequestOutcome(_KINDS[report.state], report)
