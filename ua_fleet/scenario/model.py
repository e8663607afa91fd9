"""A scenario as it is written: steps within steps. What it does is the engine's matter.

A step's key is its position, e.g. `2.parallel1.0`; the name that a task has is unique in its scenario and is how
conditions refer to its results.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from ua_fleet.scenario.expression import Expression, Value

__all__ = [
    "LEAST_PAUSE_S",
    "Argument",
    "BranchPoint",
    "Condition",
    "End",
    "EndOutcome",
    "OnTimeout",
    "OnUnknown",
    "Parallel",
    "Parameter",
    "Repeat",
    "Scenario",
    "Sequence",
    "Step",
    "Task",
    "Wait",
    "takes_time",
]

LEAST_PAUSE_S: Final = 0.05
"""A repetition takes at least so long: each time is written down."""

Argument = Value | Expression
"""A value as it is written, or an expression over parameters, results and robots' values (`=angle / 2`)."""


class OnUnknown(StrEnum):
    """What to do when nobody can tell whether a task was done, or still is."""

    ASK = "ask"
    """A person decides; at the limit what `on_limit` says."""
    RETRY = "retry"
    """The same robot once more, when it is heard and known not to be at it."""
    FAIL = "fail"
    """The task fails, and nobody takes it over."""
    REPLACE = "replace"
    """Another robot begins, though the first one may still be at it: the author consents to that."""


class OnTimeout(StrEnum):
    """What to do when what is waited for does not come."""

    FAIL = "fail"
    CONTINUE = "continue"


class EndOutcome(StrEnum):
    """How a run may be ended by a step."""

    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Parameter:
    """A value that is given when a run starts."""

    name: str
    default: Value | None = None
    unit: str | None = None
    range: tuple[float, float] | None = None
    description: str = ""

    @property
    def required(self) -> bool:
        """Whether it has to be given."""
        return self.default is None


@dataclass(frozen=True, slots=True)
class Task:
    """One skill on one robot, or on whichever robot has the capacities."""

    key: str
    line: int
    name: str
    skill: str
    robot: str | None = None
    capacities: tuple[str, ...] = ()
    arguments: Mapping[str, Argument] = field(default_factory=dict[str, Argument])
    quantities: Mapping[str, tuple[float, str]] = field(default_factory=dict[str, tuple[float, str]])
    """Arguments whose text reads as a number with its unit."""
    timeout_s: float | None = None
    """None takes the skill's own."""
    retries: int = 0
    on_unknown: OnUnknown = OnUnknown.ASK
    after: tuple[str, ...] = ()
    """Tasks that must have been done before, also those of other branches."""


@dataclass(frozen=True, slots=True)
class Sequence:
    """Steps one after the other."""

    key: str
    line: int
    steps: tuple[Step, ...]


@dataclass(frozen=True, slots=True)
class Parallel:
    """Branches side by side; it ends when all have ended, and has failed if one has."""

    key: str
    line: int
    branches: tuple[Sequence, ...]


@dataclass(frozen=True, slots=True)
class Condition:
    """One of two ways."""

    key: str
    line: int
    when: Expression
    then: Sequence
    otherwise: Sequence
    timeout_s: float = 10.0
    """How long a value that is not known is waited for."""


@dataclass(frozen=True, slots=True)
class Repeat:
    """A body again and again: so many times, or while a condition holds, or both."""

    key: str
    line: int
    body: Sequence
    times: int | None = None
    while_: Expression | None = None
    timeout_s: float = 10.0


@dataclass(frozen=True, slots=True)
class Wait:
    """Until a condition holds, an event happens, or some time is over."""

    key: str
    line: int
    until: Expression | None = None
    event: str | None = None
    for_s: float | None = None
    timeout_s: float | None = None
    on_timeout: OnTimeout = OnTimeout.FAIL


@dataclass(frozen=True, slots=True)
class End:
    """The run ends here."""

    key: str
    line: int
    outcome: EndOutcome
    reason: str = ""


@dataclass(frozen=True, slots=True)
class BranchPoint:
    """Where the way of an `if`, or whether a `repeat` goes on, is decided for steps that others do (carried runs). Its
    key is that of the `if` or `repeat`; it is the last step of what one bridge does.
    """

    key: str
    line: int
    condition: Expression | None = None
    timeout_s: float = 10.0
    is_loop: bool = False
    times: int | None = None
    round: int = 0
    """The repetition that would begin; the first is 0."""


Step = Task | Sequence | Parallel | Condition | Repeat | Wait | End | BranchPoint


@dataclass(frozen=True, slots=True)
class Scenario:
    """What an operator runs."""

    name: str
    body: Sequence
    description: str = ""
    parameters: tuple[Parameter, ...] = ()
    text: str = ""
    """The file as it was read: a run keeps it, whatever becomes of the file."""
    scope: str = ""
    """The numbers of the repetitions around it, `@0@3`, where it is a part of a scenario that a bridge does."""
    outside: frozenset[str] = frozenset()
    """Tasks beside this part, which others do, and of which the run is told what became of them."""

    def steps(self) -> Iterator[Step]:
        """Every step, in the order in which it is written."""
        return _walk(self.body)

    def tasks(self) -> Iterator[Task]:
        """Every task, in the order in which it is written."""
        return (step for step in self.steps() if isinstance(step, Task))

    def names(self) -> Iterator[str]:
        """Every name that a condition or an argument mentions."""
        for step in self.steps():
            match step:
                case Task(arguments=arguments):
                    expressions = [value for value in arguments.values() if isinstance(value, Expression)]
                case Condition(when=when):
                    expressions = [when]
                case Repeat(while_=condition) | Wait(until=condition) | BranchPoint(condition=condition):
                    expressions = [] if condition is None else [condition]
                case _:
                    continue
            for expression in expressions:
                yield from expression.names


def _walk(step: Step) -> Iterator[Step]:
    yield step
    inner: tuple[Step, ...]
    match step:
        case Sequence(steps=inner) | Parallel(branches=inner):
            pass
        case Condition(then=then, otherwise=otherwise):
            inner = (then, otherwise)
        case Repeat(body=body):
            inner = (body,)
        case _:
            return
    for part in inner:
        yield from _walk(part)


def takes_time(step: Step) -> bool:
    """Whether a step cannot be over at once, whatever way it goes: what is repeated has to."""
    match step:
        case Sequence(steps=inner) | Parallel(branches=inner):
            return any(takes_time(part) for part in inner)
        case Condition(then=then, otherwise=otherwise):
            return takes_time(then) and takes_time(otherwise)
        case Repeat(body=body):
            return takes_time(body)
        case Wait(for_s=for_s):
            return for_s is not None and for_s >= LEAST_PAUSE_S
        case Task() | End():
            return True
        case BranchPoint():
            return False
