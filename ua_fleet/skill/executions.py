"""Executions: what is asked for, by whom, and how far it has come. Vocabulary of both sides of an Action.

An execution is one wish that a robot does one thing, once. Its id has 16 bytes and is CorrelationData on the wire: who
asks chooses it, and never uses it for anything else. A request has an issue time beside it, the same in each repetition
and in each run of the requestor; the issue times of one space strictly increase. That is what lets a responder forget
old executions and still do nothing twice (`responder.py`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Any, Final, NamedTuple

from ua_fleet.topics import check_space
from ua_fleet.values import StatusCode, Variant
from ua_fleet.wire.packed_fields import pack_fields, unpack_fields

__all__ = [
    "CONTROL_BITS",
    "EXECUTION_ID_BYTES",
    "HALT_TARGETS",
    "MOST_HALTS",
    "NEVER_BEGUN",
    "NOT_REACHED",
    "OPEN",
    "RESUME_TARGETS",
    "ROBOT_STANDS",
    "SUSPEND_TARGETS",
    "ExecutionReport",
    "ExecutionState",
    "OutcomeKind",
    "RequestOutcome",
    "RequestorName",
    "Target",
    "halt_id",
    "is_control",
    "is_halt",
    "is_halted_by",
    "is_same_content",
    "named_results",
    "pack",
    "unpack",
]

EXECUTION_ID_BYTES: Final = 16


HALT_TARGETS: Final = 0x8000
"""Bit of an ActionTargetId: the target at which executions of the target without it are halted."""
SUSPEND_TARGETS: Final = 0xC000
"""The same to suspend them. It has the bit of halting too: all targets with that bit are for what is under way."""
RESUME_TARGETS: Final = 0xA000
"""The same to have them go on."""
CONTROL_BITS: Final = HALT_TARGETS | SUSPEND_TARGETS | RESUME_TARGETS
"""What of an ActionTargetId says which of these it is; none of them: a target that executes."""


def is_control(target: Target) -> bool:
    """Whether it is for what is under way: to halt, suspend or resume it."""
    return bool(target.action_target_id & CONTROL_BITS)


def is_halt(target: Target) -> bool:
    """Whether executions of the target without that bit are halted there."""
    return target.action_target_id & CONTROL_BITS == HALT_TARGETS


_NUMBER_BYTES: Final = 2
"""Of the id of a request to halt: which of the requests about one execution it is."""
MOST_HALTS: Final = 1 << 8 * _NUMBER_BYTES


def halt_id(execution_id: bytes, number: int = 0) -> bytes:
    """The id of a request to halt an execution: each bit the other way, and the number in its last bytes.

    So it names its execution without an argument, and is made once however often it is repeated. A robot that has not
    stopped is told again by the next number.
    """
    inverted = int.from_bytes(bytes([byte ^ 0xFF for byte in execution_id]))
    return (inverted ^ number).to_bytes(EXECUTION_ID_BYTES)


def is_halted_by(execution_id: bytes, request_id: bytes) -> bool:
    """Whether a request to halt is about an execution, whatever its number."""
    return halt_id(execution_id)[:-_NUMBER_BYTES] == request_id[:-_NUMBER_BYTES]


class ExecutionState(IntEnum):
    """How far an execution has come, as its responder knows it. The numbers travel, also in SkillStatus."""

    REFUSED = 0
    """It was not begun and never will be."""
    TIMED_OUT = 1
    """The same, because its time was over before it could begin."""
    RUNNING = 2
    """Accepted: the robot was told, once."""
    DONE = 3
    FAILED = 4
    """It was begun and did not succeed."""
    UNKNOWN = 5
    """It may have been begun, and nobody can tell what became of it."""
    ASKING = 6
    """The responder was started anew and asks the robot what became of it."""
    SUSPENDED = 7
    """The robot stands in the middle of it until it is told to go on, or to stop."""


ROBOT_STANDS: Final = frozenset({StatusCode.BAD_DEVICE_FAILURE, StatusCode.BAD_OUT_OF_SERVICE})
"""StatusCodes of an end with which a driver says more than that the skill failed: the robot itself stands in an error
state (an emergency or protective stop, a device failure), and can do nothing else either."""
NOT_REACHED: Final = frozenset({StatusCode.BAD_NO_COMMUNICATION, StatusCode.BAD_NOT_CONNECTED})
"""StatusCodes of an end with which a driver says that it did not reach the robot, so that nothing was begun. What it
had told and then lost, it forgets (ExecutionForgotten)."""
OPEN: Final = frozenset({ExecutionState.RUNNING, ExecutionState.ASKING, ExecutionState.SUSPENDED})
"""States from which another follows."""
NEVER_BEGUN: Final = frozenset({ExecutionState.REFUSED, ExecutionState.TIMED_OUT})


class OutcomeKind(StrEnum):
    """What a requestor knows of its request. Each request gets exactly one, and Unknown may be corrected later."""

    ACCEPTED = "accepted"
    """The robot was told exactly once; how it ends comes in the same answer (immediate skills) or in SkillStatus."""
    REFUSED = "refused"
    """The responder says: never begun, and never will be."""
    TIMED_OUT = "timed_out"
    """The responder says the same, because the time was over: nobody has to look after the robot."""
    UNKNOWN = "unknown"
    """Nobody could say whether the robot was told: no answer came, or the responder itself cannot tell."""


class Target(NamedTuple):
    """What an Action is asked of: the Responder's DataSetWriter and the Action target."""

    publisher_id: int
    writer_group_id: int
    data_set_writer_id: int
    action_target_id: int


class ExecutionReport(NamedTuple):
    """The state of an execution with what belongs to it; `result` is packed (see `pack`)."""

    state: ExecutionState
    status: int = StatusCode.GOOD
    message: str = ""
    result: bytes = b""


@dataclass(frozen=True, slots=True)
class RequestOutcome:
    """What a requestor ends with. `report` is the responder's last word; its state is UNKNOWN where none came."""

    kind: OutcomeKind
    report: ExecutionReport
    names: tuple[str, ...] | None = field(default=None, compare=False)
    """Of the results in `report`, in their order, as the responder announces them; None where that is not known.

    It says how to read an outcome, and is no part of it: no journal keeps it.
    """


_NAME: Final = re.compile(r"(0|[1-9][0-9]{0,4})\.([A-Za-z0-9_-]{1,64})", re.ASCII)


class RequestorName(NamedTuple):
    """RequestorId: `<space>.<instance>`."""

    space: int
    instance: str

    @classmethod
    def parse(cls, text: str | None) -> RequestorName | None:
        """The name in a RequestorId; None for any other text, and for a number that is no space."""
        found = _NAME.fullmatch(text or "")
        if found is None or int(found[1]) > 0xFFFF:
            return None
        return cls(int(found[1]), found[2])

    @classmethod
    def checked(cls, space: int, instance: str) -> RequestorName:
        """The name of two parts; TopicInvalid or ValueError where they make none."""
        if cls.parse(f"{check_space(space)}.{instance}") is None:
            raise ValueError(f"{instance!r} cannot stand in a RequestorId: 1 to 64 letters, digits, - and _")
        return cls(space, instance)

    @property
    def text(self) -> str:
        """As it travels."""
        return f"{self.space}.{self.instance}"


def pack(types: tuple[int, ...], values: tuple[Any, ...]) -> bytes:
    """Values as bytes, for the journal and to compare two requests: Variants one after the other.

    Raises LocalWireError for values that do not fit their types.
    """
    return pack_fields(types, values).content


def unpack(content: bytes) -> tuple[Variant, ...]:
    """The values that were packed."""
    fields = unpack_fields(content)
    return tuple(map(Variant, fields.types, fields))


def is_same_content(one: bytes, other: bytes) -> bool:
    """Whether packed values are the same, however their bytes were written: a Boolean may be any but 0."""
    return one == other or _rewritten(one) == _rewritten(other)


def _rewritten(content: bytes) -> bytes:
    fields = unpack_fields(content)
    return pack_fields(fields.types, tuple(fields)).content


def named_results(outcome: RequestOutcome, declared: Sequence[str]) -> dict[str, Any]:
    """The results of an outcome by their names.

    Where nobody knows the responder's names (its announcement was not heard since a restart) the one result that is
    declared is the one that came; of several it is not known which is which, and SkillStatus tells them by name.
    """
    values = [variant.value for variant in unpack(outcome.report.result)]
    names = outcome.names
    if names is None:
        names = tuple(declared) if len(declared) == 1 else ()
    return dict(zip(names, values, strict=False))
