"""Statements that run themselves; see `nodes.py`."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

from ua_demo.simulators.ur.urscript.nodes import (
    Expression,
    Flow,
    Function,
    Scope,
    Statement,
    list_of,
    position_in,
    run_block,
)
from ua_demo.simulators.ur.urscript.values import ScriptError, copied, truth

__all__ = [
    "Assign",
    "AssignItem",
    "Define",
    "Evaluate",
    "If",
    "Kill",
    "Leave",
    "Pass",
    "Return",
    "While",
]


@dataclass(frozen=True, slots=True)
class Evaluate:
    """An expression for what it does."""

    line: int
    expression: Expression

    def run(self, scope: Scope) -> Generator[None, None, Flow]:
        """See Statement."""
        yield from self.expression.value(scope)
        return Flow.NEXT


@dataclass(frozen=True, slots=True)
class Assign:
    """`x = ..`, `global x = ..` and `local x = ..`."""

    line: int
    name: str
    expression: Expression
    kind: str = ""

    def run(self, scope: Scope) -> Generator[None, None, Flow]:
        """See Statement."""
        value = copied((yield from self.expression.value(scope)))
        if self.kind == "global":
            owner = scope.outermost
        elif self.kind == "local":
            owner = scope
        else:
            owner = scope.find(self.name) or scope
        owner.variables[self.name] = value
        return Flow.NEXT


@dataclass(frozen=True, slots=True)
class AssignItem:
    """`x[i] = ..`."""

    line: int
    name: str
    at: Expression
    expression: Expression

    def run(self, scope: Scope) -> Generator[None, None, Flow]:
        """See Statement."""
        owner = scope.find(self.name)
        if owner is None:
            raise ScriptError(f"there is no variable {self.name}")
        items = owner.variables[self.name]
        position = yield from self.at.value(scope)
        value = copied((yield from self.expression.value(scope)))
        list_of(items)[position_in(items, position)] = value
        return Flow.NEXT


@dataclass(frozen=True, slots=True)
class Define:
    """`def` and `thread`."""

    line: int
    name: str
    parameters: tuple[str, ...]
    body: tuple[Statement, ...]

    def run(self, scope: Scope) -> Generator[None, None, Flow]:
        """See Statement."""
        scope.variables[self.name] = Function(self.name, self.parameters, self.body, scope)
        yield from ()
        return Flow.NEXT


@dataclass(frozen=True, slots=True)
class If:
    """The first block whose condition holds."""

    line: int
    branches: tuple[tuple[Expression, tuple[Statement, ...]], ...]
    otherwise: tuple[Statement, ...]

    def run(self, scope: Scope) -> Generator[None, None, Flow]:
        """See Statement."""
        for condition, block in self.branches:
            if truth((yield from condition.value(scope))):
                return (yield from run_block(block, scope))
        return (yield from run_block(self.otherwise, scope))


@dataclass(frozen=True, slots=True)
class While:
    """As long as a condition holds."""

    line: int
    condition: Expression
    body: tuple[Statement, ...]

    def run(self, scope: Scope) -> Generator[None, None, Flow]:
        """See Statement."""
        while truth((yield from self.condition.value(scope))):
            flow = yield from run_block(self.body, scope)
            if flow is Flow.BREAK:
                break
            if flow is Flow.RETURN:
                return flow
            if scope.runner.spend():
                yield
        return Flow.NEXT


@dataclass(frozen=True, slots=True)
class Return:
    """Leave the function."""

    line: int
    expression: Expression | None

    def run(self, scope: Scope) -> Generator[None, None, Flow]:
        """See Statement."""
        if self.expression is not None:
            scope.returned = yield from self.expression.value(scope)
        return Flow.RETURN


@dataclass(frozen=True, slots=True)
class Leave:
    """`break` and `continue`."""

    line: int
    flow: Flow

    def run(self, scope: Scope) -> Generator[None, None, Flow]:
        """See Statement."""
        yield from ()
        return self.flow


@dataclass(frozen=True, slots=True)
class Kill:
    """`kill` and `join`."""

    line: int
    handle: Expression
    waits: bool

    def run(self, scope: Scope) -> Generator[None, None, Flow]:
        """See Statement."""
        handle = yield from self.handle.value(scope)
        if self.waits:
            yield from scope.runner.join_thread(handle)
        else:
            scope.runner.kill_thread(handle)
        return Flow.NEXT


@dataclass(frozen=True, slots=True)
class Pass:
    """Nothing to do: `enter_critical` and `exit_critical`, since threads change only where one waits, and `pass`."""

    line: int

    def run(self, scope: Scope) -> Generator[None, None, Flow]:
        """See Statement."""
        yield from ()
        return Flow.NEXT
