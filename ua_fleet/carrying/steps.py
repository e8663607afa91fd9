"""Steps of a scenario and what is within them, as splitting looks at them."""

from __future__ import annotations

from ua_fleet.scenario.expression import Expression
from ua_fleet.scenario.model import BranchPoint, Condition, Parallel, Repeat, Sequence, Step, Task, Wait

__all__ = ["inner_steps", "names_at", "names_in", "tasks_in", "walked"]


def inner_steps(step: Step) -> tuple[Step, ...]:
    """The steps right within one."""
    match step:
        case Sequence(steps=inner) | Parallel(branches=inner):
            return inner
        case Condition(then=then, otherwise=otherwise):
            return then, otherwise
        case Repeat(body=body):
            return (body,)
        case _:
            return ()


def walked(step: Step) -> list[Step]:
    """A step and all within it."""
    return [step, *(each for part in inner_steps(step) for each in walked(part))]


def tasks_in(step: Step) -> list[Task]:
    """The tasks of a step."""
    return [each for each in walked(step) if isinstance(each, Task)]


def names_at(step: Step) -> set[str]:
    """The names that a step itself mentions."""
    expressions: list[Expression] = []
    match step:
        case Task(arguments=arguments):
            expressions = [value for value in arguments.values() if isinstance(value, Expression)]
        case Condition(when=when):
            expressions = [when]
        case Repeat(while_=condition) | Wait(until=condition) | BranchPoint(condition=condition):
            expressions = [] if condition is None else [condition]
        case _:
            pass
    return {name for expression in expressions for name in expression.names}


def names_in(step: Step) -> set[str]:
    """The names that a step and all within it mention."""
    return {name for each in walked(step) for name in names_at(each)}
