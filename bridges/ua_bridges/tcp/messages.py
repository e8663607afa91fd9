"""Messages between the bridge and a small program on a robot, as fields. Pure.

    type  subtype  number  size  data ...

`size` says how many data fields follow. `number` belongs to an execution, 1 to 2147483647, and is 0 where there is
none. The types of TalkRoBots (3.2.3), and what they are here:

    to the robot     command       do a skill (an Action): subtype is the skill, data are the arguments
                     request       do an immediate skill
                     information   a value (a DataSet): subtype is the data, data are the fields
                     query         what became of this number? subtype is the skill
                     halt          stop this number

    from the robot   status        of a number: subtype is running, done, failed, refused, halted, unknown or never
                     information   a value, as above
                     request       tell me the data `subtype` of another robot; information with this number answers
                     ack           a field was read (framing `acknowledged` only); a single field, no message

The paper's Source, Target and Size in bytes have no use on a socket between two: the number names what is answered.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import Any, Final, NamedTuple

from ua_fleet.config.base import ScalarType
from ua_fleet.fleet.skills import ArgumentModel, argument_problem

__all__ = [
    "ACK",
    "Message",
    "MessageReader",
    "MessageRefused",
    "RobotState",
    "Type",
    "field_of",
    "fields_of",
    "number_of",
    "value_of",
]

ACK: Final = "ack"
_HEAD: Final = 4
_MOST_DIGITS: Final = 10
_GREATEST: Final = 2**31 - 1


class Type(StrEnum):
    """What a message is."""

    COMMAND = "command"
    REQUEST = "request"
    INFORMATION = "information"
    QUERY = "query"
    HALT = "halt"
    STATUS = "status"


class RobotState(StrEnum):
    """What a robot's program says of a number."""

    RUNNING = "running"
    """It is at it; the data may be how far, 0 to 1."""
    DONE = "done"
    """The data are the results."""
    FAILED = "failed"
    """The data may be the reason."""
    REFUSED = "refused"
    """It has not begun it and will not; the data may be the reason."""
    BUSY = "busy"
    """The same, because it is at another one: it may be asked again."""
    HALTED = "halted"
    """It was stopped."""
    UNKNOWN = "unknown"
    """It does not remember."""
    NEVER = "never"
    """It never heard of it, and forgets nothing."""


class MessageRefused(Exception):
    """Fields that are no message; the text says why."""


class Message(NamedTuple):
    """One message."""

    type: Type
    subtype: str
    number: int
    data: tuple[str, ...] = ()

    def fields(self) -> tuple[str, ...]:
        """The message as fields, in their order."""
        return (self.type, self.subtype, str(self.number), str(len(self.data)), *self.data)


FROM_ROBOT: Final = frozenset({Type.STATUS, Type.INFORMATION, Type.REQUEST})


def number_of(execution_id: bytes) -> int:
    """The number that an execution has for a robot: the same after every restart, so nothing has to be kept."""
    return int.from_bytes(execution_id[:4], "big") % _GREATEST + 1


class MessageReader:
    """Puts a robot's fields together."""

    def __init__(self, most_fields: int) -> None:
        self._most = most_fields
        self._head: list[str] = []
        self._data: list[str] = []
        self._size = 0

    @property
    def is_within(self) -> bool:
        """Whether a message was begun and has not ended."""
        return bool(self._head)

    def feed(self, field: str) -> Message | None:
        """The message that this field completes.

        Raises:
            MessageRefused: the field cannot stand where it stands.
        """
        if len(self._head) < _HEAD:
            self._head.append(self._checked(len(self._head), field))
            if len(self._head) < _HEAD:
                return None
            self._size = int(field)
        else:
            self._data.append(field)
        if len(self._data) < self._size:
            return None
        message = Message(Type(self._head[0]), self._head[1], int(self._head[2]), tuple(self._data))
        self._head, self._data = [], []
        return message

    def _checked(self, place: int, field: str) -> str:
        if place == 0 and field not in FROM_ROBOT:
            raise MessageRefused(f"a message of type {field[:40]!r}; there are {', '.join(sorted(FROM_ROBOT))}")
        if place == 1 and not field:
            raise MessageRefused("a message without subtype")
        if place > 1:
            if not field.isascii() or not field.isdecimal() or len(field) > _MOST_DIGITS or int(field) > _GREATEST:
                raise MessageRefused(f"{'number' if place == 2 else 'size'} {field[:40]!r} is no whole number")
            if place == 3 and int(field) > self._most:
                raise MessageRefused(f"{field} data fields; most_fields is {self._most}")
        return field


def field_of(value: Any) -> str:
    """A value as a field: 1 or 0 for Booleans, `.` in decimals, the text of a String."""
    if isinstance(value, bool):
        return "1" if value else "0"
    if isinstance(value, float):
        return format(value, ".15g") if math.isfinite(value) else "nan"
    return str(value) if value is not None else ""


def value_of(field: str, wanted: ScalarType) -> Any:
    """The value of a field.

    Raises:
        ValueError: the type cannot hold it.
    """
    value: Any = field
    if wanted is ScalarType.BOOLEAN:
        if field.lower() not in ("0", "1", "true", "false"):
            raise ValueError(f"{field[:40]!r} is no Boolean: 1 or 0")
        return field.lower() in ("1", "true")
    if wanted is not ScalarType.STRING:
        if len(field) > 40 or "_" in field:  # `float` takes 1_000
            raise ValueError(f"{field[:40]!r} is no {wanted.value}")
        value = float(field)
        if wanted not in (ScalarType.FLOAT, ScalarType.DOUBLE):
            if not math.isfinite(value) or not value.is_integer():
                raise ValueError(f"{field!r} is no whole number")
            value = int(field) if field.lstrip("+-").isdecimal() else int(value)
    if (problem := argument_problem(ArgumentModel("the field", int(wanted.builtin)), value)) is not None:
        raise ValueError(problem)
    return value


def fields_of(values: Sequence[Any]) -> tuple[str, ...]:
    """Values as data fields."""
    return tuple([field_of(value) for value in values])
