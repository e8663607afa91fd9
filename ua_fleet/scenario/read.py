"""A scenario's file, YAML or JSON, as steps; every mistake with its line.

What is wrong by itself is found here; what is wrong for a fleet (an unknown robot) by `validate`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any, Final, NamedTuple, TypeVar, cast

from ua_fleet.document import Document, KeyPath, as_mapping, read_document
from ua_fleet.errors import ConfigError, ScenarioInvalid
from ua_fleet.names import closest, listed
from ua_fleet.scenario.expression import Expression, ExpressionInvalid, parse_expression
from ua_fleet.scenario.model import (
    LEAST_PAUSE_S,
    Argument,
    Condition,
    End,
    EndOutcome,
    OnTimeout,
    OnUnknown,
    Parallel,
    Parameter,
    Repeat,
    Scenario,
    Sequence,
    Step,
    Task,
    Wait,
    takes_time,
)
from ua_fleet.values import is_finite

__all__ = [
    "MOST_REPEATS",
    "MOST_RETRIES",
    "MOST_SECONDS",
    "MOST_STEPS",
    "STEP_KEYS",
    "VERSION",
    "ScenarioReading",
    "read_scenario",
    "scenario_of",
]

VERSION: Final = 1
"""The version of the format that this code reads."""
MOST_STEPS: Final = 10_000
MOST_REPEATS: Final = 1_000_000
"""Of all repetitions within each other together."""
MOST_RETRIES: Final = 100
MOST_SECONDS: Final = 1e8
"""Three years."""

_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}")
_QUANTITY: Final = re.compile(r"([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s+([^\s0-9].*)")
"""A number with its unit, `20 deg`."""

_COMMON: Final = ("description",)
STEP_KEYS: Final[dict[str, tuple[str, ...]]] = {
    "task": (
        *("task", "skill", "robot", "capacity", "capacities", "arguments"),
        *("timeout_s", "retries", "on_unknown", "after"),
    ),
    "sequence": ("sequence",),
    "parallel": ("parallel",),
    "if": ("if", "then", "else", "timeout_s"),
    "repeat": ("repeat", "times", "while", "timeout_s"),
    "wait": ("wait", "until", "event", "timeout_s", "on_timeout"),
    "end": ("end", "reason"),
}
"""What each kind of step may have; its first key tells the kind."""

_E = TypeVar("_E", bound=StrEnum)


class ScenarioReading(NamedTuple):
    """What a file holds, as far as it could be read. Run only what has no problems."""

    scenario: Scenario
    problems: tuple[ConfigError, ...]


def scenario_of(text: str, file: str = "") -> Scenario:
    """The scenario in a text.

    Raises:
        ScenarioInvalid: with every problem and its line.
    """
    reading = read_scenario(text.encode(), file)
    if reading.problems:
        raise ScenarioInvalid([str(problem) for problem in reading.problems])
    return reading.scenario


def read_scenario(content: bytes, file: str = "") -> ScenarioReading:
    """Read a file's bytes; `file` is its name in problems. JSON is read as the YAML that it is."""
    document = read_document(content, file)
    if document.is_newer_than(VERSION) or (document.problems and not document.data):
        return ScenarioReading(Scenario("", Sequence("", 0, ())), tuple(document.problems))
    scenario = _Reader(document).scenario(content.decode("utf-8", "replace"))
    problems = sorted(document.problems, key=lambda problem: problem.line)
    return ScenarioReading(scenario, tuple(problems))


class _Reader:
    def __init__(self, document: Document) -> None:
        self._document = document
        self._names: dict[str, int] = {}
        """Tasks and the lines where they stand."""
        self._steps = 0
        self._times = 1
        """How often a step is repeated by all that is around it."""

    def scenario(self, text: str) -> Scenario:
        data = self._document.data
        self._known_keys((), data, ("version", "name", "description", "parameters", "steps"))
        if data.get("version") != VERSION:
            self._problem(("version",), f"this program reads version {VERSION}", f"write `version: {VERSION}`")
        name = self._text((), data, "name", required=True)
        if name and not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]{0,63}", name):
            self._problem(("name",), "a name begins with a letter; then letters, digits, _ and -, 64 at most")
        parameters = tuple(self._parameters(data.get("parameters")))
        if not data.get("steps"):
            self._problem(("steps",), "a scenario has at least one step")
        body = self._sequence(data.get("steps"), ("steps",), "")
        return Scenario(name, body, self._text((), data, "description"), parameters, text)

    # Steps.

    def _sequence(self, value: Any, path: KeyPath, key: str) -> Sequence:
        """A list of steps; a single step stands for a list of one."""
        line = self._line(path)
        if as_mapping(value) is not None:
            step = self._step(value, path, _joined(key, 0))
            return Sequence(key, line, () if step is None else (step,))
        if not isinstance(value, list):
            if value is not None:
                self._problem(path, "is no list of steps", "begin each step with `- `")
            return Sequence(key, line, ())
        steps: list[Step] = []
        for number, item in enumerate(cast("list[object]", value)):
            step = self._step(item, (*path, number), _joined(key, number))
            if step is not None:
                steps.append(step)
        return Sequence(key, line, tuple(steps))

    def _step(self, value: Any, path: KeyPath, key: str) -> Step | None:
        self._steps += 1
        if self._steps == MOST_STEPS + 1:
            self._problem(path, f"a scenario has at most {MOST_STEPS} steps")
        if self._steps > MOST_STEPS:
            return None
        data = as_mapping(value)
        if data is None:
            self._problem(path, "is no step", f"a step begins with one of {listed(STEP_KEYS)}")
            return None
        kinds = [kind for kind in STEP_KEYS if kind in data]
        if len(kinds) != 1:
            what = f"is {' and '.join(f'`{kind}`' for kind in kinds)} at once" if kinds else "is of no kind"
            self._problem(path, f"the step {what}", f"a step has exactly one of {listed(STEP_KEYS)}")
            return None
        kind = kinds[0]
        self._known_keys(path, data, (*STEP_KEYS[kind], *_COMMON))
        readers: dict[str, Callable[[dict[str, Any], KeyPath, str], Step | None]] = {
            "task": self._task,
            "sequence": lambda step, at, name: self._sequence(step["sequence"], (*at, "sequence"), name),
            "parallel": self._parallel,
            "if": self._condition,
            "repeat": self._repeat,
            "wait": self._wait,
            "end": self._end,
        }
        return readers[kind](data, path, key)

    def _task(self, data: dict[str, Any], path: KeyPath, key: str) -> Task:
        line = self._line(path)
        name = self._text(path, data, "task", required=True)
        if name and not _NAME.fullmatch(name):
            self._problem((*path, "task"), f"{name!r}: a task's name has letters, digits and _, at most 64")
        elif name in self._names:
            self._problem((*path, "task"), f"there is a task {name!r} in line {self._names[name]} already")
        elif name:
            self._names[name] = line
        capacities = self._texts(path, data, "capacities")
        if "capacity" in data:
            capacities = (*capacities, self._text(path, data, "capacity"))
        robot = self._text(path, data, "robot") or None
        if (robot is None) == (not capacities):
            self._problem(path, f"task {name!r} needs either a `robot` or a `capacity`")
        arguments, quantities = self._arguments(data.get("arguments"), (*path, "arguments"))
        return Task(
            key=key,
            line=line,
            name=name,
            skill=self._text(path, data, "skill", required=True),
            robot=robot,
            capacities=capacities,
            arguments=arguments,
            quantities=quantities,
            timeout_s=self._seconds(path, data, "timeout_s"),
            retries=self._whole(path, data, "retries", 0, MOST_RETRIES) or 0,
            on_unknown=self._choice(path, data, "on_unknown", OnUnknown, OnUnknown.ASK),
            after=self._texts(path, data, "after"),
        )

    def _parallel(self, data: dict[str, Any], path: KeyPath, key: str) -> Parallel:
        at = (*path, "parallel")
        branches = cast("list[object]", data["parallel"]) if isinstance(data["parallel"], list) else []
        if len(branches) < 2:
            self._problem(at, "side by side are at least two steps or lists of steps")
        return Parallel(
            key,
            self._line(path),
            tuple(
                self._sequence(branch, (*at, number), _joined(key, number)) for number, branch in enumerate(branches)
            ),
        )

    def _condition(self, data: dict[str, Any], path: KeyPath, key: str) -> Condition | None:
        then = self._sequence(data.get("then"), (*path, "then"), f"{key}.then")
        otherwise = self._sequence(data.get("else"), (*path, "else"), f"{key}.else")
        if not then.steps and not otherwise.steps:
            self._problem(path, "this condition has no steps", "give it `then`, `else`, or both")
        when = self._expression(data["if"], (*path, "if"))
        timeout_s = self._seconds(path, data, "timeout_s")
        if when is None:
            return None
        return Condition(key, self._line(path), when, then, otherwise, 10.0 if timeout_s is None else timeout_s)

    def _repeat(self, data: dict[str, Any], path: KeyPath, key: str) -> Repeat:
        times = self._whole(path, data, "times", 1, MOST_REPEATS)
        while_ = self._expression(data["while"], (*path, "while")) if "while" in data else None
        if times is None and "while" not in data:
            self._problem(path, "would repeat for ever", "give `times`, `while`, or both")
        around, self._times = self._times, self._times * (times or 1)
        if around <= MOST_REPEATS < self._times:
            self._problem((*path, "times"), f"would repeat {self._times} times in all; at most {MOST_REPEATS} are done")
        body = self._sequence(data["repeat"], (*path, "repeat"), f"{key}.repeat")
        self._times = around
        if not body.steps:
            self._problem((*path, "repeat"), "nothing is repeated")
        elif not takes_time(body):
            self._problem(
                (*path, "repeat"), "would turn without a pause", f"put a task or `wait: {LEAST_PAUSE_S}` on each way"
            )
        timeout_s = self._seconds(path, data, "timeout_s")
        return Repeat(key, self._line(path), body, times, while_, 10.0 if timeout_s is None else timeout_s)

    def _wait(self, data: dict[str, Any], path: KeyPath, key: str) -> Wait:
        for_s = None if data["wait"] is None else self._seconds(path, data, "wait")
        until = self._expression(data["until"], (*path, "until")) if "until" in data else None
        event = self._text(path, data, "event") or None
        if sum(("until" in data, "event" in data, data["wait"] is not None)) != 1:
            self._problem(
                path, "waits for no one thing", "write `wait: SECONDS`, or `wait:` with either `until` or `event`"
            )
        timeout_s = self._seconds(path, data, "timeout_s")
        on_timeout = self._choice(path, data, "on_timeout", OnTimeout, OnTimeout.FAIL)
        return Wait(key, self._line(path), until, event, for_s, timeout_s, on_timeout)

    def _end(self, data: dict[str, Any], path: KeyPath, key: str) -> End:
        outcome = self._choice(path, data, "end", EndOutcome, EndOutcome.DONE)
        return End(key, self._line(path), outcome, self._text(path, data, "reason"))

    # Values.

    def _parameters(self, value: Any) -> list[Parameter]:
        path: KeyPath = ("parameters",)
        if value is None:
            return []
        data = as_mapping(value)
        if data is None:
            self._problem(path, "parameters are names with their keys")
            return []
        found: list[Parameter] = []
        for name, given in data.items():
            at = (*path, name)
            if not _NAME.fullmatch(name):
                self._problem(at, f"{name!r}: a parameter's name has letters, digits and _, at most 64")
            keys = as_mapping(given)
            if keys is None:
                keys = {"default": given}
            self._known_keys(at, keys, ("default", "unit", "range", "description"))
            default = keys.get("default")
            if not (default is None or _is_value(default)):
                self._problem((*at, "default"), "a default is a number, a text, true or false")
                default = None
            limits = self._range(at, keys)
            if limits and isinstance(default, int | float) and not limits[0] <= default <= limits[1]:
                self._problem((*at, "default"), f"{default:g} is outside of {limits[0]:g} to {limits[1]:g}")
            unit = self._text(at, keys, "unit") or None
            found.append(Parameter(name, default, unit, limits, self._text(at, keys, "description")))
        return found

    def _range(self, path: KeyPath, data: Mapping[str, Any]) -> tuple[float, float] | None:
        value = data.get("range")
        if value is None:
            return None
        numbers = _numbers(value)
        if len(numbers) == 2 and numbers[0] < numbers[1]:
            return numbers[0], numbers[1]
        self._problem((*path, "range"), "a range is two numbers, the lesser first", "write e.g. `range: [0, 100]`")
        return None

    def _arguments(self, value: Any, path: KeyPath) -> tuple[dict[str, Argument], dict[str, tuple[float, str]]]:
        arguments: dict[str, Argument] = {}
        quantities: dict[str, tuple[float, str]] = {}
        data = as_mapping(value)
        if data is None:
            if value is not None:
                self._problem(path, "arguments are names with values", "write e.g. `arguments: {angle: 20}`")
            return arguments, quantities
        for name, given in data.items():
            at = (*path, name)
            if isinstance(given, str) and given.startswith("="):
                expression = self._expression(given[1:], at)
                if expression is not None:
                    arguments[name] = expression
            elif _is_value(given):
                arguments[name] = given
                quantity = _QUANTITY.fullmatch(given) if isinstance(given, str) else None
                if quantity is not None and _is_number(quantity[1]):
                    quantities[name] = float(quantity[1]), quantity[2].strip()
            else:
                self._problem(at, "an argument is a number, a text, true, false, or an expression after `=`")
        return arguments, quantities

    def _expression(self, value: Any, path: KeyPath) -> Expression | None:
        text = str(value).lower() if isinstance(value, bool) else str(value)
        if not isinstance(value, bool | int | float | str):
            self._problem(path, "is no condition", "write e.g. `if: temperature > 20`")
            return None
        try:
            return parse_expression(text)
        except ExpressionInvalid as error:
            self._problem(path, str(error))
            return None

    def _text(self, path: KeyPath, data: Mapping[str, Any], key: str, *, required: bool = False) -> str:
        value = data.get(key)
        if value is None and not required:
            return ""
        if not isinstance(value, str) or not value:
            self._problem((*path, key), f"`{key}` is missing" if value is None else f"`{key}` must be a text")
            return ""
        return value

    def _texts(self, path: KeyPath, data: Mapping[str, Any], key: str) -> tuple[str, ...]:
        value = data.get(key)
        if value is None:
            return ()
        items = cast("list[object]", value) if isinstance(value, list) else [value]
        names = tuple(item for item in items if isinstance(item, str) and item)
        if len(names) != len(items):
            self._problem((*path, key), f"`{key}` must be a list of names")
        return names

    def _seconds(self, path: KeyPath, data: Mapping[str, Any], key: str) -> float | None:
        value = data.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= MOST_SECONDS:
            self._problem((*path, key), f"`{key}` must be a number of seconds above 0, at most {MOST_SECONDS:g}")
            return None
        return float(value)

    def _whole(self, path: KeyPath, data: Mapping[str, Any], key: str, least: int, most: int) -> int | None:
        value = data.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            self._problem((*path, key), f"`{key}` must be a whole number from {least} to {most}")
            return None
        return value

    def _choice(self, path: KeyPath, data: Mapping[str, Any], key: str, kind: type[_E], default: _E) -> _E:
        value = data.get(key)
        if value is None:
            return default
        try:
            return kind(value)
        except ValueError:
            known = [member.value for member in kind]
            self._problem((*path, key), f"`{key}` is one of {listed(known)}", closest(str(value), known))
            return default

    def _known_keys(self, path: KeyPath, data: Mapping[str, Any], known: tuple[str, ...]) -> None:
        for key in data:
            if key not in known:
                hint = closest(key, known) or f"known keys: {listed(known)}"
                self._problem((*path, key), f"unknown key `{key}`", hint)

    def _line(self, path: KeyPath) -> int:
        return self._document.place_of(path).line

    def _problem(self, path: KeyPath, message: str, suggestion: str = "") -> None:
        self._document.problem(path, message, suggestion)


def _joined(key: str, number: int) -> str:
    return f"{key}.{number}" if key else str(number)


def _numbers(value: Any) -> list[float]:
    """The numbers of a list of numbers; of anything else none."""
    items = cast("list[object]", value) if isinstance(value, list) else []
    numbers = [
        float(item)
        for item in items
        if isinstance(item, int | float) and not isinstance(item, bool) and is_finite(item)
    ]
    return numbers if len(numbers) == len(items) else []


def _is_value(value: object) -> bool:
    return isinstance(value, str) or (isinstance(value, bool | int | float) and is_finite(value))


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
