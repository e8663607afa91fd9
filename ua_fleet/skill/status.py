"""SkillStatus: the last executions of one robot as the fields of a DataSet.

Arrays of the same length, the oldest execution first, so that an end is never overwritten by the next start. An
execution keeps its place from its start on.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple, cast

from ua_fleet.skill.executions import ExecutionState
from ua_fleet.values import ARRAY, BuiltinType
from ua_fleet.wire.messages import FieldMetaData

__all__ = [
    "MOST_SHOWN",
    "ROBOT_PROPERTY",
    "SKILL_STATUS_FIELDS",
    "ExecutionStatus",
    "SkillStatus",
    "read_result",
    "read_status",
    "result_text",
]

MOST_SHOWN: Final = 8

_FIELDS: Final = (
    ("ExecutionId", BuiltinType.BYTE_STRING),
    ("Skill", BuiltinType.STRING),
    ("State", BuiltinType.BYTE),
    ("Progress", BuiltinType.FLOAT),
    ("Result", BuiltinType.STRING),
    ("Message", BuiltinType.STRING),
    ("Status", BuiltinType.STATUS_CODE),
)
ROBOT_PROPERTY: Final = "UaFleetRobot"
"""Property of the first field of a robot's SkillStatus: what the robot is, as JSON in the form of `fleet.yaml`."""
SKILL_STATUS_FIELDS: Final = tuple([FieldMetaData(name, kind, value_rank=1) for name, kind in _FIELDS])
"""State is an ExecutionState; Result a JSON object with the results by their names, empty before the end; Status the
StatusCode of the end, an array that leaves out the Good ones at its end and so is mostly empty."""
_STATES: Final = frozenset(ExecutionState)
_TYPES: Final = tuple([kind | ARRAY for _, kind in _FIELDS])


class ExecutionStatus(NamedTuple):
    """One execution as it is shown."""

    execution_id: bytes
    skill: str
    state: ExecutionState
    progress: float = 0.0
    """0 to 1."""
    result: str = ""
    message: str = ""
    status: int = 0
    """StatusCode of its end."""


class SkillStatus:
    """What is shown of one robot's executions."""

    def __init__(self) -> None:
        self._shown: dict[bytes, ExecutionStatus] = {}

    def show(self, status: ExecutionStatus) -> bool:
        """Show an execution, or its new state; whether that changed anything."""
        if self._shown.get(status.execution_id) == status:
            return False
        self._shown[status.execution_id] = status
        if len(self._shown) > MOST_SHOWN:
            del self._shown[next(iter(self._shown))]
        return True

    def get(self, execution_id: bytes) -> ExecutionStatus | None:
        """What is shown of an execution; None where it is no longer shown."""
        return self._shown.get(execution_id)

    def fields(self) -> tuple[tuple[int, ...], tuple[tuple[Any, ...], ...]]:
        """Types and values of the DataSet."""
        columns = tuple(zip(*self._shown.values(), strict=True)) or ((),) * len(_FIELDS)
        *others, statuses = [tuple([_plain(value) for value in column]) for column in columns]
        last_bad = max((number for number, status in enumerate(statuses, 1) if status), default=0)
        return _TYPES, (*others, statuses[:last_bad])


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, ExecutionState) else value


def read_status(fields: Sequence[FieldMetaData], values: Sequence[Any]) -> Iterator[ExecutionStatus]:
    """The executions that a SkillStatus tells of. Whoever sent it: a row that is none is left out.

    Args:
        fields: as they were announced.
        values: of one message.
    """
    columns: dict[str, Sequence[Any]] = {
        field.name: value for field, value in zip(fields, values, strict=False) if isinstance(value, tuple | list)
    }
    *names, last = [name for name, _ in _FIELDS]
    statuses = columns.get(last, ())
    for number, row in enumerate(zip(*[columns.get(name, ()) for name in names], strict=False)):
        execution_id, skill, state, progress, result, message = row
        status = statuses[number] if number < len(statuses) else 0
        texts = (skill, result or "", message or "")
        if not isinstance(execution_id, bytes) or not all(isinstance(text, str) for text in texts):
            continue
        if not (isinstance(progress, int | float | None) and isinstance(state, int) and state in _STATES):
            continue
        known = status if isinstance(status, int) else 0
        yield ExecutionStatus(execution_id, skill, ExecutionState(state), float(progress or 0.0), *texts[1:], known)


def result_text(results: Mapping[str, Any]) -> str:
    """Results by their names as they stand in Result."""
    return json.dumps(dict(results), ensure_ascii=False, separators=(",", ":")) if results else ""


def read_result(text: str) -> dict[str, Any]:
    """The results in a Result; none where it is empty or no JSON object."""
    try:
        results: object = json.loads(text) if text else {}
    except (ValueError, RecursionError):  # whoever sent it may have nested it deeply
        return {}
    return cast("dict[str, Any]", results) if isinstance(results, dict) else {}
