"""Conditions in scenarios: `temperature > 20`, `fetch.weight <= limit and not gate.open`.

Names are dotted: a parameter, the result of a task, or a value of a robot (`ur3.temperature`, and of an array one
element, `ur3.joints[1]`, counted from 0). What Python would read otherwise, as a name with a `-` or the word `in`,
stands in backquotes: "`agv-1.speed` > 2". Comparisons may be chained; `and`, `or`, `not`, `+ - * /` and parentheses are
there, calls and everything else are not. The text is read by Python's parser and checked node by node, so nothing of
Python can be reached.
"""

from __future__ import annotations

import ast
import keyword
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from ua_fleet.errors import ScenarioError
from ua_fleet.values import is_finite

__all__ = ["Expression", "ExpressionInvalid", "Lookup", "Value", "ValueUnknown", "parse_expression", "split_index"]

Value = bool | int | float | str
Lookup = Callable[[str], Value]
"""The value of a name now; raises ValueUnknown."""

MOST_CHARACTERS: Final = 1000
MOST_DEPTH: Final = 30
MOST_SHOWN: Final = 60
"""Characters of a number or text in a message."""

_QUOTED: Final = re.compile(r"""'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|`([A-Za-z][\w-]*(?:\.[A-Za-z][\w-]*)*)`""")
"""A text, or a name in backquotes."""
_STAND_IN: Final = 0xA000
"""The first of a thousand letters that nobody writes; an identifier with one, as long as the name, stands in for it."""
_WORDS: Final = {"true": True, "false": False}
_ARITHMETIC: Final[dict[type[ast.operator], Callable[[float, float], float]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: lambda a, b: a / b,
}
_ORDER: Final[dict[type[ast.cmpop], Callable[[float, float], bool]]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


class ExpressionInvalid(ScenarioError):
    """A text that is no condition."""

    remedy = "Correct the condition (docs/scenarios.md)."


class ValueUnknown(ScenarioError):
    """A condition cannot be decided now: a value is not known, or is of the wrong kind."""

    remedy = "Wait until the robot tells the value, or correct its name in the condition."

    def __init__(self, message: str, robot: str = "") -> None:
        """Say why; `robot` is whose value it is, where that is known."""
        super().__init__(message)
        self.robot = robot


@dataclass(frozen=True, slots=True)
class Expression:
    """A condition that was read; `names` are all that it mentions."""

    text: str
    names: frozenset[str]
    _tree: ast.expr

    def value(self, lookup: Lookup) -> Value:
        """What the expression comes to.

        Raises:
            ValueUnknown: a name has no value now, or values of these kinds cannot be put together so.
        """
        return _evaluate(self._tree, lookup)

    def holds(self, lookup: Lookup) -> bool:
        """Whether the condition is true now; raises ValueUnknown as `value` does, and where it is not true or false."""
        value = self.value(lookup)
        if not isinstance(value, bool):
            raise ValueUnknown(f"{self.text!r} is {value!r}, neither true nor false")
        return value


def parse_expression(text: str) -> Expression:
    """Read a condition.

    Raises:
        ExpressionInvalid: with the place in the text.
    """
    if len(text) > MOST_CHARACTERS:
        raise ExpressionInvalid(f"a condition has at most {MOST_CHARACTERS} characters, this one {len(text)}")
    stand_ins: dict[str, str] = {}

    def stand_in(found: re.Match[str]) -> str:
        if found[1] is None:
            return found[0]
        identifier = chr(_STAND_IN + len(stand_ins)).ljust(len(found[0]), "x")
        stand_ins[identifier] = found[1]
        return identifier

    try:
        tree = ast.parse(_QUOTED.sub(stand_in, text.strip()), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        column = getattr(error, "offset", None)
        where = f" at character {column}" if column else ""
        raise ExpressionInvalid(f"{text!r} is no condition{where}; write e.g. {_example(text)}") from None
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            node.id = stand_ins.get(node.id, node.id)
    names: set[str] = set()
    _check(tree, names, text, 0)
    return Expression(text.strip(), frozenset(names), tree)


def _example(text: str) -> str:
    """A condition that is one, beside a text that is none."""
    words = {word for word in re.findall(r"[a-z]+", text) if keyword.iskeyword(word)} - {"and", "or", "not"}
    if words or "-" in text:
        return "temperature > 20, and in backquotes a name with - or that is a Python keyword: `agv-1.temperature` > 20"
    return "temperature > 20"


def _check(node: ast.expr, names: set[str], text: str, depth: int) -> None:
    if depth > MOST_DEPTH:
        raise ExpressionInvalid(f"{text!r} is nested deeper than {MOST_DEPTH} levels")
    match node:
        case ast.Name() | ast.Attribute() | ast.Subscript():
            name = _dotted(node)
            if name is None:
                raise ExpressionInvalid(f"{text!r}: names are like robot.value or robot.value[0]")
            if name not in _WORDS:
                names.add(name)
            return
        case ast.Constant(value=str()):
            return
        case ast.Constant(value=bool() | int() | float() as value):
            if not _fits(value):
                raise ExpressionInvalid(f"{_short(text)}: a number is too large")
            return
        case ast.UnaryOp(op=ast.Not() | ast.USub() | ast.UAdd(), operand=operand):
            inner = [operand]
        case ast.BoolOp(values=inner):
            pass
        case ast.Compare(left=left, ops=ops, comparators=others) if all(
            isinstance(op, ast.Eq | ast.NotEq) or type(op) in _ORDER for op in ops
        ):
            inner = [left, *others]
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _ARITHMETIC:
            inner = [left, right]
        case _:
            what = type(node).__name__.lower()
            raise ExpressionInvalid(
                f"{text!r}: no {what} here; conditions have names, numbers, texts, comparisons, and, or, not, + - * /"
            )
    for part in inner:
        _check(part, names, text, depth + 1)


def _dotted(node: ast.expr) -> str | None:
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (owner := _dotted(node.value)) is not None:
        return f"{owner}.{node.attr}"
    if isinstance(node, ast.Subscript) and (owner := _dotted(node.value)) is not None:
        index = node.slice.value if isinstance(node.slice, ast.Constant) else None
        return f"{owner}[{index}]" if type(index) is int else None
    return None


def split_index(name: str) -> tuple[str, int | None]:
    """`joints[1]` as `joints` and 1; a name without an index with None."""
    if not name.endswith("]"):
        return name, None
    owner, _, index = name[:-1].rpartition("[")
    return owner, int(index)


def _evaluate(node: ast.expr, lookup: Lookup) -> Value:
    match node:
        case ast.Constant(value=bool() | int() | float() | str() as value):
            return value
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return not _truth(_evaluate(operand, lookup))
        case ast.UnaryOp(op=sign, operand=operand):
            number = _number(_evaluate(operand, lookup))
            return -number if isinstance(sign, ast.USub) else number
        case ast.BoolOp(op=connective, values=parts):
            stop = isinstance(connective, ast.Or)
            for part in parts:
                if _truth(_evaluate(part, lookup)) is stop:
                    return stop
            return not stop
        case ast.Compare(left=left, ops=comparisons, comparators=others):
            before = _evaluate(left, lookup)
            for comparison, other in zip(comparisons, others, strict=True):
                after = _evaluate(other, lookup)
                if not _compare(comparison, before, after):
                    return False
                before = after
            return True
        case ast.BinOp(left=left, op=arithmetic, right=right):
            a, b = _number(_evaluate(left, lookup)), _number(_evaluate(right, lookup))
            try:
                number = _ARITHMETIC[type(arithmetic)](a, b)
            except (ZeroDivisionError, OverflowError) as error:
                raise ValueUnknown(f"{a:g} and {b:g}: {error}") from None
            if not _fits(number):
                raise ValueUnknown(f"{a:g} and {b:g}: what they come to is too large")
            return number
        case _:
            name = _dotted(node)
            assert name is not None, "checked when it was read"
            return _WORDS[name] if name in _WORDS else lookup(name)


def _truth(value: Value) -> bool:
    if not isinstance(value, bool):
        raise ValueUnknown(f"{value!r} is neither true nor false")
    return value


def _number(value: Value) -> float:
    if isinstance(value, bool | str):
        raise ValueUnknown(f"{value!r} is no number")
    if not _fits(value):
        raise ValueUnknown(f"{_short(str(value))} is too large")
    return value


def _fits(number: float) -> bool:
    """Whether a number can be reckoned with; an integer may be too large to be made a float."""
    return is_finite(number) or isinstance(number, float)


def _short(text: str) -> str:
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}..."


def _compare(op: ast.cmpop, a: Value, b: Value) -> bool:
    if isinstance(op, ast.Eq | ast.NotEq):
        if isinstance(a, str) != isinstance(b, str) or isinstance(a, bool) != isinstance(b, bool):
            raise ValueUnknown(f"{a!r} and {b!r} cannot be compared")
        return (a == b) is isinstance(op, ast.Eq)
    return _ORDER[type(op)](_number(a), _number(b))
