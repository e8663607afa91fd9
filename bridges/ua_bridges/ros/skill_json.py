"""The JSON by which a robot's own program offers skills; `docs/skills-json.md` is its description. Pure.

std_msgs/String, one JSON object each. The bridge publishes requests on `ua_0_<ns>_<skill id>`, the program its status
on `ua_<own space>_<ns>_<skill id>`:

    {"request": "execute", "execution_id": "0f..", "skill": "drive", "arguments": {"to": "dock"}, "timeout_s": 60.0}
    {"request": "query", "cancel", "suspend" or "resume", "execution_id": "0f.."}

    {"execution_id": "0f..", "state": "running", "progress": 0.4, "results": {}, "message": ""}

`ua_bridges.robot` is the other side, and stands for itself: a robot's machine has no ua_fleet.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from enum import StrEnum
from typing import Any, Final, NamedTuple, cast

from ua_fleet.bridge.executing import Ended, ended_text
from ua_fleet.config.schema import SkillConfig
from ua_fleet.fleet.skills import argument_problem
from ua_fleet.values import BuiltinType, StatusCode

__all__ = [
    "ProgramState",
    "ProgramStatus",
    "StatusInvalid",
    "cancel_text",
    "ended_of",
    "execute_text",
    "parse_status",
    "query_text",
    "resume_text",
    "suspend_text",
]

MOST_CHARACTERS: Final = 1_000_000
EXECUTION_ID_BYTES: Final = 16


class ProgramState(StrEnum):
    """What a program says of an execution."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    """It is not begun and will not be."""
    RUNNING = "running"
    SUSPENDED = "suspended"
    """It stands in the middle of it until it is told to go on, or to stop."""
    DONE = "done"
    FAILED = "failed"
    HALTED = "halted"
    """It has stopped because it was told to."""
    UNKNOWN = "unknown"
    """The answer to a query: it remembers no such execution."""


class ProgramStatus(NamedTuple):
    """One message of a program."""

    execution_id: bytes
    state: ProgramState
    progress: float = 0.0
    results: Mapping[str, Any] = {}
    message: str = ""
    is_busy: bool = False
    """Refused because the robot is at something else: it may be asked again."""


class StatusInvalid(ValueError):
    """A text that is no status."""


def _text(**members: Any) -> str:
    return json.dumps(members, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def execute_text(execution_id: bytes, skill: str, arguments: Mapping[str, Any], timeout_s: float) -> str:
    """The request to begin an execution. Raises ValueError for an argument that JSON cannot carry (NaN)."""
    return _text(
        request="execute", execution_id=execution_id.hex(), skill=skill, arguments=dict(arguments), timeout_s=timeout_s
    )


def query_text(execution_id: bytes) -> str:
    """The question what became of an execution."""
    return _text(request="query", execution_id=execution_id.hex())


def cancel_text(execution_id: bytes) -> str:
    """The request to stop an execution."""
    return _text(request="cancel", execution_id=execution_id.hex())


def suspend_text(execution_id: bytes) -> str:
    """The request to stand in the middle of an execution."""
    return _text(request="suspend", execution_id=execution_id.hex())


def resume_text(execution_id: bytes) -> str:
    """The request to go on with it."""
    return _text(request="resume", execution_id=execution_id.hex())


def parse_status(text: str) -> ProgramStatus:
    """Read what a program says; members that are not known are left out of account.

    Raises:
        StatusInvalid: with the reason.
    """
    if len(text) > MOST_CHARACTERS:
        raise StatusInvalid(f"a status of {len(text)} characters; at most {MOST_CHARACTERS} are read")
    try:
        parsed: object = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise StatusInvalid(f"not JSON: {error}") from None
    if not isinstance(parsed, dict):
        raise StatusInvalid("not a JSON object")
    members = cast("dict[str, Any]", parsed)
    return ProgramStatus(
        _execution_id(members.get("execution_id")),
        _state(members.get("state")),
        _progress(members.get("progress", 0.0)),
        _results(members.get("results")),
        _message(members.get("message")),
        members.get("busy") is True,
    )


def _execution_id(value: Any) -> bytes:
    try:
        execution_id = bytes.fromhex(value)
    except (TypeError, ValueError):
        execution_id = b""
    if len(execution_id) != EXECUTION_ID_BYTES:
        raise StatusInvalid("`execution_id` has to be the 32 hexadecimal digits of the request")
    return execution_id


def _state(value: Any) -> ProgramState:
    try:
        return ProgramState(value)
    except ValueError:
        raise StatusInvalid(f"`state` is one of {', '.join(ProgramState)}, not {value!r:.50}") from None


def _progress(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 1:
        raise StatusInvalid(f"`progress` is a number from 0 to 1, not {value!r:.50}")
    return float(value)


def _results(value: Any) -> Mapping[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise StatusInvalid("`results` is an object with the results by their names")
    return cast("dict[str, Any]", value)


def _message(value: Any) -> str:
    if value is None:
        return ""
    if not isinstance(value, str):
        raise StatusInvalid("`message` is a text")
    return ended_text(value)


def ended_of(status: ProgramStatus, skill: SkillConfig) -> Ended:
    """The end that a status in one of the states of an end tells."""
    if status.state is ProgramState.REFUSED:
        code = StatusCode.BAD_TOO_MANY_OPERATIONS if status.is_busy else StatusCode.BAD_REQUEST_NOT_ALLOWED
        return Ended(code, (), status.message or "the robot's program refused it")
    if status.state is ProgramState.HALTED:
        return Ended(StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT, (), status.message or "it was halted")
    if status.state is ProgramState.FAILED:
        return Ended(StatusCode.BAD_UNEXPECTED_ERROR, (), status.message or "the robot's program says that it failed")
    values: list[Any] = []
    for name, result in skill.results.items():
        value: Any = status.results.get(name)
        model = replace(result.model(name), range=None)  # a robot may well measure more than was expected
        problem = argument_problem(model, value) if name in status.results else f"{name} is missing"
        if problem is not None:
            return Ended(StatusCode.UNCERTAIN, (), f"it is done; its results are not those of the skill: {problem}")
        if result.type.builtin in (BuiltinType.FLOAT, BuiltinType.DOUBLE):
            values.append(float(value))
        else:
            values.append(int(value) if isinstance(value, float) else value)  # a whole number by the check above
    return Ended(StatusCode.GOOD, tuple(values), status.message)
