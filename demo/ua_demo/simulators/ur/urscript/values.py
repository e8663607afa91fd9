"""What variables hold, and what operators make of it."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, Final, TypeAlias

__all__ = ["OPERATORS", "Pose", "ScriptError", "Value", "copied", "items_of", "negative", "shown", "truth"]

_LONGEST_TEXT: Final = 65_536
_INT_LIMIT: Final = 2**31


class Pose(list[float]):
    """`p[x, y, z, rx, ry, rz]`: m and a rotation vector in rad."""


Value: TypeAlias = object
"""A bool, int, float, str, Pose, list of values, function of the program, or a thread's handle."""


class ScriptError(Exception):
    """A program that cannot be read, or cannot go on. `line` counts from 1; 0 where it is not known."""

    def __init__(self, reason: str, line: int = 0) -> None:
        self.reason, self.line = reason, line
        super().__init__(f"line {line}: {reason}" if line else reason)


def items_of(value: Value) -> list[Any] | None:
    """The elements of a list or a pose; None where it is neither."""
    found: Any = value
    return found if isinstance(value, list) else None


def copied(value: Value) -> Value:
    """A list is a value, and no reference: who gets it may change it."""
    items = items_of(value)
    if items is None:
        return value
    return Pose(items) if isinstance(value, Pose) else [copied(item) for item in items]


def truth(value: Value) -> bool:
    """A condition has to be a Boolean.

    Raises:
        ScriptError: it is none.
    """
    if isinstance(value, bool):
        return value
    raise ScriptError(f"a condition is True or False, and not {shown(value)}")


def shown(value: Value) -> str:
    """A value as textmsg writes it."""
    items = items_of(value)
    if items is not None:
        return f"{'p' if isinstance(value, Pose) else ''}[{', '.join(shown(item) for item in items)}]"
    if isinstance(value, float):
        return f"{value:g}"
    return str(value)


def _number(value: Value) -> int | float:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return value
    raise ScriptError(f"a number was expected, and there is {shown(value)}")


def _arithmetic(function: Callable[[Any, Any], Any]) -> Callable[[Value, Value], Value]:
    def calculate(left: Value, right: Value) -> Value:
        lefts, rights = items_of(left), items_of(right)
        if lefts is not None and rights is not None and len(lefts) == len(rights):
            items: list[Any] = [calculate(one, other) for one, other in zip(lefts, rights, strict=True)]
            return Pose(items) if isinstance(left, Pose) else items
        try:
            found = function(_number(left), _number(right))
        except (ZeroDivisionError, OverflowError, ValueError) as error:
            raise ScriptError(str(error)) from error
        if isinstance(found, complex):
            raise ScriptError("a root of a negative number")
        # Integers of a controller have 32 bits; these would grow without bound.
        return float(found) if isinstance(found, int) and abs(found) >= _INT_LIMIT else found

    return calculate


_plus = _arithmetic(operator.add)
_times = _arithmetic(operator.mul)


def _add(left: Value, right: Value) -> Value:
    if isinstance(left, str) or isinstance(right, str):
        text = shown(left) + shown(right)
        if len(text) > _LONGEST_TEXT:
            raise ScriptError(f"a text of more than {_LONGEST_TEXT} characters")
        return text
    return _plus(left, right)


def _multiply(left: Value, right: Value) -> Value:
    for many, one in ((items_of(left), right), (items_of(right), left)):
        if many is not None and items_of(one) is None:
            return [_times(item, one) for item in many]
    return _times(left, right)


def _ordered(function: Callable[[Any, Any], bool]) -> Callable[[Value, Value], Value]:
    return lambda left, right: function(_number(left), _number(right))


def negative(value: Value) -> Value:
    """The value with another sign."""
    return _multiply(value, -1)


OPERATORS: Final[dict[str, Callable[[Value, Value], Value]]] = {
    "+": _add,
    "-": _arithmetic(operator.sub),
    "*": _multiply,
    "/": _arithmetic(lambda left, right: left / right),
    "%": _arithmetic(operator.mod),
    "^": _arithmetic(lambda left, right: float(left) ** right),
    "==": operator.eq,
    "!=": operator.ne,
    "<": _ordered(operator.lt),
    "<=": _ordered(operator.le),
    ">": _ordered(operator.gt),
    ">=": _ordered(operator.ge),
    "xor": lambda left, right: truth(left) != truth(right),
}
