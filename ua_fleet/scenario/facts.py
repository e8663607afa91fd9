"""What happened in a run: the records of its journal. A run's state is what its facts come to, and nothing else."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final, get_type_hints

from ua_fleet.scenario.expression import Value

__all__ = [
    "AdoptionTold",
    "BranchTaken",
    "EventSeen",
    "Fact",
    "IterationStarted",
    "OutsideTold",
    "Replaced",
    "ReplacementWanted",
    "RobotReturned",
    "RunAdopted",
    "RunCarried",
    "RunClosing",
    "RunCreated",
    "RunEnded",
    "RunOutcome",
    "RunPaused",
    "RunResumed",
    "StandInTold",
    "StepEnded",
    "StepStarted",
    "StepState",
    "TaskAccepted",
    "TaskAnswered",
    "TaskAssigned",
    "TaskFound",
    "TaskHalting",
    "TaskOutcome",
    "TaskOver",
    "Then",
    "decode_fact",
    "encode_fact",
]


class StepState(StrEnum):
    """How a step ended."""

    DONE = "done"
    FAILED = "failed"


class TaskOutcome(StrEnum):
    """How one attempt at a task ended."""

    DONE = "done"
    FAILED = "failed"
    """The robot could not do this; nothing says that it could not do something else."""
    STOPPED = "stopped"
    """The robot failed, and stands in an error state, as its driver says."""
    REFUSED = "refused"
    BUSY = "busy"
    """The robot would not begin it now, while it is at something else."""
    UNREACHED = "unreached"
    """It was not begun: the bridge did not reach the robot."""
    TIMED_OUT = "timed_out"
    UNKNOWN = "unknown"
    """Nobody can tell whether it was done."""
    FAULT = "fault"
    """The robot failed meanwhile."""
    HALTED = "halted"
    """Somebody else than the run had the robot stop."""


class Then(StrEnum):
    """What follows the end of an attempt."""

    DONE = "done"
    FAILED = "failed"
    RETRY = "retry"
    ASK = "ask"
    """An operator is asked."""
    AWAIT = "await"
    """The robot is waited for, until it is heard and known not to be at it; then it is asked once more."""
    REPLACE = "replace"
    """Another robot is looked for."""


class RunOutcome(StrEnum):
    """How a run ended."""

    DONE = "done"
    FAILED = "failed"
    ABORTED = "aborted"


@dataclass(frozen=True, slots=True)
class RunCreated:
    """A run begins; the scenario's text is kept with it."""

    at: float
    run_id: str
    text: str
    parameters: Mapping[str, Value] = field(default_factory=dict[str, Value])
    by: str = ""


@dataclass(frozen=True, slots=True)
class RunCarried:
    """Bridges carry the run; the server gives each its part, begins it, and follows. The second fact of such a run."""

    at: float
    spaces: Sequence[int]
    """Of the bridges."""
    plan_hash: str
    """In hexadecimal digits."""
    parts: Sequence[str] = ()
    """What each of the bridges got, likewise: another one may have to go on with it when fleet.yaml has changed."""
    first: int = 0
    """The space of the bridge that begins; 0: an earlier version has not said it."""


@dataclass(frozen=True, slots=True)
class RunAdopted:
    """A person has said that a bridge of a carried run is off: another one goes on with what it had."""

    at: float
    space: int
    """Of the bridge that is off."""
    heir: int
    """Of the one that goes on; 0: none does, and the run ends without the bridge, which is told when it answers."""
    done: Sequence[str]
    """Tasks that its robots have done, as the person says, although nobody has told so."""
    by: str
    also: Sequence[int] = ()
    """Those left out just before, of which not all others knew yet: the same one goes on for all."""


@dataclass(frozen=True, slots=True)
class AdoptionTold:
    """All bridges of a carried run know which ones are off, as said last: nobody has to be told that once more."""

    at: float


@dataclass(frozen=True, slots=True)
class StepStarted:
    """A step's turn has come. `step` is its key, with the repetition where there are several."""

    at: float
    step: str


@dataclass(frozen=True, slots=True)
class BranchTaken:
    """A condition was decided."""

    at: float
    step: str
    then: bool


@dataclass(frozen=True, slots=True)
class IterationStarted:
    """A repetition begins; the first is 0."""

    at: float
    step: str
    number: int


@dataclass(frozen=True, slots=True)
class TaskAssigned:
    """An attempt at a task begins on a robot. Journaled before the robot hears of it."""

    at: float
    step: str
    task: str
    attempt: int
    robot: str
    execution_id: str
    skill: str
    arguments: Mapping[str, Value] = field(default_factory=dict[str, Value])


@dataclass(frozen=True, slots=True)
class TaskAccepted:
    """The robot has taken it."""

    at: float
    step: str
    attempt: int


@dataclass(frozen=True, slots=True)
class TaskHalting:
    """The robot is told to stop; what follows waits until it says that it has stopped."""

    at: float
    step: str
    attempt: int
    outcome: TaskOutcome
    """What the attempt has ended with once it has: FAULT or TIMED_OUT."""
    reason: str


@dataclass(frozen=True, slots=True)
class TaskFound:
    """A robot of which nobody knew what it was at says that it still does this."""

    at: float
    step: str
    attempt: int


@dataclass(frozen=True, slots=True)
class TaskOver:
    """An attempt has ended, and what follows: one fact, so that no crash can come between the two."""

    at: float
    step: str
    attempt: int
    outcome: TaskOutcome
    then: Then
    message: str = ""
    results: Mapping[str, Value] = field(default_factory=dict[str, Value])


@dataclass(frozen=True, slots=True)
class TaskAnswered:
    """An operator has said whether a task was done."""

    at: float
    step: str
    then: Then
    by: str


@dataclass(frozen=True, slots=True)
class ReplacementWanted:
    """A task's robot cannot even begin; another is looked for."""

    at: float
    step: str
    robot: str
    reason: str
    task: str = ""
    """Its name; empty, like its skill, in the journal of an earlier version."""
    skill: str = ""


@dataclass(frozen=True, slots=True)
class Replaced:
    """Another robot takes a task over."""

    at: float
    step: str
    failed: str
    robot: str
    by: str
    lasting: bool = True
    """Whether it stands in for later tasks too, until the one that failed is back; else that one only failed at this
    task."""
    capacities: Sequence[str] = ()
    """It stands in for tasks that need one of these; empty: for all."""


@dataclass(frozen=True, slots=True)
class RobotReturned:
    """A robot that failed takes its later tasks back."""

    at: float
    robot: str
    capacity: str = ""
    """Only those that need this; empty: those for which no capacity was named."""


@dataclass(frozen=True, slots=True)
class EventSeen:
    """An event that a step waited for has happened."""

    at: float
    step: str
    event: str


@dataclass(frozen=True, slots=True)
class OutsideTold:
    """A part of a carried run is told what became of a task of another branch, which another part does."""

    at: float
    task: str
    is_done: bool
    """Else it was not done, and will not be."""
    results: Mapping[str, Value] = field(default_factory=dict[str, Value])
    """Those that are read here, by their names."""


@dataclass(frozen=True, slots=True)
class StandInTold:
    """A part of a carried run is told who stands in for a robot, as another part has chosen."""

    at: float
    failed: str
    robot: str
    capacity: str = ""
    """It stands in for tasks that need this; empty: for all."""


@dataclass(frozen=True, slots=True)
class StepEnded:
    """A step is over."""

    at: float
    step: str
    state: StepState
    reason: str = ""


@dataclass(frozen=True, slots=True)
class RunPaused:
    """No further task begins."""

    at: float
    by: str = ""


@dataclass(frozen=True, slots=True)
class RunResumed:
    """The run goes on."""

    at: float
    by: str = ""


@dataclass(frozen=True, slots=True)
class RunClosing:
    """The run is to end before its last step: an operator or an `end` step says so. Tasks in hand are cancelled."""

    at: float
    outcome: RunOutcome
    reason: str
    by: str = ""


@dataclass(frozen=True, slots=True)
class RunEnded:
    """The run is over."""

    at: float
    outcome: RunOutcome
    reason: str = ""


Fact = (
    RunCreated
    | RunAdopted
    | AdoptionTold
    | RunCarried
    | StepStarted
    | BranchTaken
    | IterationStarted
    | TaskAssigned
    | TaskAccepted
    | TaskHalting
    | TaskFound
    | TaskOver
    | TaskAnswered
    | ReplacementWanted
    | Replaced
    | RobotReturned
    | StandInTold
    | EventSeen
    | OutsideTold
    | StepEnded
    | RunPaused
    | RunResumed
    | RunClosing
    | RunEnded
)

_KINDS: Final[dict[str, type[Any]]] = {kind.__name__: kind for kind in Fact.__args__}
_FIELDS: Final[dict[type[Any], tuple[str, ...]]] = {
    kind: tuple(one.name for one in dataclasses.fields(kind)) for kind in _KINDS.values()
}
"""No value of these is a dataclass or holds one: `asdict`, which looks for them, takes longer than all the rest."""
_ENUMS: Final = {
    name: {
        field_name: hint
        for field_name, hint in get_type_hints(kind).items()
        if isinstance(hint, type) and issubclass(hint, StrEnum)
    }
    for name, kind in _KINDS.items()
}


_encode: Final = json.JSONEncoder(ensure_ascii=False).encode


def encode_fact(fact: Fact) -> str:
    """A fact as one line of JSON."""
    kind = type(fact)
    data: dict[str, Any] = {"fact": kind.__name__}
    for name in _FIELDS[kind]:
        data[name] = getattr(fact, name)
    return _encode(data)


def decode_fact(line: str) -> Fact:
    """The fact in a line.

    Raises:
        ValueError: the line holds none that this program knows.
    """
    try:
        data: dict[str, Any] = json.loads(line)
        name = data.pop("fact")
        for key, value in data.items():
            items: Any = value
            if isinstance(value, list):
                data[key] = tuple(items)
        for key, kind in _ENUMS[name].items():
            data[key] = kind(data[key])
        fact: Fact = _KINDS[name](**data)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"no fact of a run: {error}") from error
    return fact
