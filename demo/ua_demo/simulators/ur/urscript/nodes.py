"""Expressions that run themselves, and what they share with statements.

Each is a generator: what it yields means "go on at the controller's next step", what it returns is its value. So a
program waits for the end of a move in the middle of an expression, as programs do on a controller.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, Final, Protocol, cast

from ua_demo.simulators.ur.urscript.values import (
    OPERATORS,
    Pose,
    ScriptError,
    Value,
    copied,
    items_of,
    negative,
    truth,
)

__all__ = [
    "Binary",
    "Call",
    "Constant",
    "Expression",
    "Flow",
    "Function",
    "Index",
    "Items",
    "Logic",
    "Name",
    "Negative",
    "Not",
    "Run",
    "Runner",
    "Scope",
    "Statement",
    "Steps",
    "list_of",
    "position_in",
    "run_block",
]

Steps = Generator[None, None, Value]
_DEEPEST: Final = 64
"""Calls within calls."""


class Flow(Enum):
    """How a statement ended."""

    NEXT = auto()
    BREAK = auto()
    CONTINUE = auto()
    RETURN = auto()


class Runner(Protocol):
    """What statements need of the program that they belong to."""

    def builtin(self, name: str) -> Callable[..., Any] | None:
        """A function of the controller, plain or a generator."""
        ...

    def spend(self) -> bool:
        """One turn of a loop is taken; True when the thread has to leave the rest for the next step."""
        ...

    def start_thread(self, name: str, steps: Steps) -> object:
        """A new thread."""
        ...

    def kill_thread(self, handle: object) -> None:
        """End a thread; nothing for what is none."""
        ...

    def join_thread(self, handle: object) -> Steps:
        """Wait for the end of a thread."""
        ...


class Scope:
    """Variables of one call, inside those of the function around it."""

    __slots__ = ("depth", "outer", "returned", "runner", "variables")

    def __init__(self, runner: Runner, outer: Scope | None, depth: int = 0) -> None:
        self.runner, self.outer, self.depth = runner, outer, depth
        self.variables: dict[str, Value] = {}
        self.returned: Value = False

    def find(self, name: str) -> Scope | None:
        """The scope that has a variable."""
        scope: Scope | None = self
        while scope is not None and name not in scope.variables:
            scope = scope.outer
        return scope

    @property
    def outermost(self) -> Scope:
        """Where globals are."""
        scope = self
        while scope.outer is not None:
            scope = scope.outer
        return scope


class Expression(Protocol):
    """What has a value."""

    def value(self, scope: Scope) -> Steps:
        """The value."""
        ...


class Statement(Protocol):
    """What does something. `line` is where it stands."""

    @property
    def line(self) -> int:
        """Counts from 1."""
        ...

    def run(self, scope: Scope) -> Generator[None, None, Flow]:
        """Do it."""
        ...


def run_block(statements: Sequence[Statement], scope: Scope) -> Generator[None, None, Flow]:
    """One after the other, until one of them leaves."""
    for statement in statements:
        try:
            flow = yield from statement.run(scope)
        except ScriptError as error:
            if not error.line:
                error.line = statement.line
            raise
        if flow is not Flow.NEXT:
            return flow
    return Flow.NEXT


@dataclass(frozen=True, slots=True)
class Constant:
    """A literal."""

    literal: Value

    def value(self, scope: Scope) -> Steps:
        """See Expression."""
        yield from ()
        return self.literal


@dataclass(frozen=True, slots=True)
class Name:
    """A variable."""

    name: str

    def value(self, scope: Scope) -> Steps:
        """See Expression."""
        found = scope.find(self.name)
        if found is None:
            raise ScriptError(f"there is no variable {self.name}")
        yield from ()
        return found.variables[self.name]


@dataclass(frozen=True, slots=True)
class Items:
    """A list or a pose."""

    items: tuple[Expression, ...]
    is_pose: bool = False

    def value(self, scope: Scope) -> Steps:
        """See Expression."""
        values: list[Any] = []
        for item in self.items:
            values.append(copied((yield from item.value(scope))))  # noqa: PERF401 - a comprehension cannot yield
        return Pose(values) if self.is_pose else values


@dataclass(frozen=True, slots=True)
class Index:
    """An element of a list."""

    of: Expression
    at: Expression

    def value(self, scope: Scope) -> Steps:
        """See Expression."""
        items = yield from self.of.value(scope)
        position = yield from self.at.value(scope)
        found: Value = list_of(items)[position_in(items, position)]
        return found


def list_of(items: Value) -> list[Any]:
    """The items of a list or pose themselves; raises ScriptError for any other value."""
    found = items_of(items)
    if found is None:
        raise ScriptError("only a list has elements")
    return found


def position_in(items: Value, position: Value) -> int:
    """A place that a list or pose has; raises ScriptError."""
    if isinstance(position, bool) or not isinstance(position, int):
        raise ScriptError("the place in a list is an integer")
    if not 0 <= position < len(list_of(items)):
        raise ScriptError(f"a list of {len(list_of(items))} has no element {position}")
    return position


@dataclass(frozen=True, slots=True)
class Binary:
    """Two values and what is between them."""

    operator: str
    left: Expression
    right: Expression

    def value(self, scope: Scope) -> Steps:
        """See Expression."""
        left = yield from self.left.value(scope)
        right = yield from self.right.value(scope)
        return OPERATORS[self.operator](left, right)


@dataclass(frozen=True, slots=True)
class Logic:
    """`and` and `or`; what is not needed is not evaluated."""

    is_and: bool
    parts: tuple[Expression, ...]

    def value(self, scope: Scope) -> Steps:
        """See Expression."""
        for part in self.parts:
            if truth((yield from part.value(scope))) is not self.is_and:
                return not self.is_and
        return self.is_and


@dataclass(frozen=True, slots=True)
class Not:
    """The opposite."""

    of: Expression

    def value(self, scope: Scope) -> Steps:
        """See Expression."""
        return not truth((yield from self.of.value(scope)))


@dataclass(frozen=True, slots=True)
class Negative:
    """With another sign."""

    of: Expression

    def value(self, scope: Scope) -> Steps:
        """See Expression."""
        return negative((yield from self.of.value(scope)))


@dataclass(frozen=True, slots=True)
class Function:
    """A function of the program, with the scope that it was defined in."""

    name: str
    parameters: tuple[str, ...]
    body: tuple[Statement, ...]
    scope: Scope

    def call(self, arguments: Sequence[Value], named: dict[str, Value], depth: int) -> Steps:
        """Run it.

        Raises:
            ScriptError: the arguments are not those that it takes, or calls are too deep.
        """
        if depth > _DEEPEST:
            raise ScriptError(f"{self.name} calls itself more than {_DEEPEST} times")
        bound = dict(zip(self.parameters, arguments, strict=False)) | named
        if len(arguments) > len(self.parameters) or set(bound) != set(self.parameters):
            raise ScriptError(f"{self.name} takes ({', '.join(self.parameters)})")
        inner = Scope(self.scope.runner, self.scope, depth)
        inner.variables.update({name: copied(value) for name, value in bound.items()})
        yield from run_block(self.body, inner)
        return inner.returned


@dataclass(frozen=True, slots=True)
class Call:
    """A call of the program's own function, or of one of the controller's."""

    name: str
    arguments: tuple[Expression, ...]
    named: tuple[tuple[str, Expression], ...] = ()

    def value(self, scope: Scope) -> Steps:
        """See Expression."""
        arguments: list[Value] = []
        for argument in self.arguments:
            arguments.append((yield from argument.value(scope)))  # noqa: PERF401 - a comprehension cannot yield
        named: dict[str, Value] = {}
        for name, argument in self.named:
            named[name] = yield from argument.value(scope)
        found = scope.find(self.name)
        function = found.variables[self.name] if found is not None else None
        if isinstance(function, Function):
            return (yield from function.call(arguments, named, scope.depth + 1))
        builtin = scope.runner.builtin(self.name)
        if builtin is None:
            raise ScriptError(f"there is no function {self.name}")
        result: Value = builtin(*[copied(argument) for argument in arguments], **named)
        if inspect.isgenerator(result):
            result = yield from cast("Steps", result)
        return False if result is None else result


@dataclass(frozen=True, slots=True)
class Run:
    """`run name()`: a thread, whose handle is the value."""

    call: Call

    def value(self, scope: Scope) -> Steps:
        """See Expression."""
        yield from ()
        return scope.runner.start_thread(self.call.name, self.call.value(Scope(scope.runner, scope)))
