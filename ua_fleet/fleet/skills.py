"""What a skill is: the capacities it needs, its typed arguments and results, and its limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from ua_fleet.fleet.quantities import UnitsDiffer, convert
from ua_fleet.values import BuiltinType, is_finite

__all__ = [
    "ArgumentModel",
    "SkillLimits",
    "SkillModel",
    "SkillValue",
    "argument_problem",
    "call_problems",
    "in_unit_of",
]

SkillValue = bool | int | float | str

INTEGER_RANGES: Final[Mapping[int, tuple[int, int]]] = {
    BuiltinType.SBYTE: (-(2**7), 2**7 - 1),
    BuiltinType.BYTE: (0, 2**8 - 1),
    BuiltinType.INT16: (-(2**15), 2**15 - 1),
    BuiltinType.UINT16: (0, 2**16 - 1),
    BuiltinType.INT32: (-(2**31), 2**31 - 1),
    BuiltinType.UINT32: (0, 2**32 - 1),
    BuiltinType.INT64: (-(2**63), 2**63 - 1),
    BuiltinType.UINT64: (0, 2**64 - 1),
}
_FLOATS: Final = (BuiltinType.FLOAT, BuiltinType.DOUBLE)


@dataclass(frozen=True, slots=True)
class ArgumentModel:
    """One argument or result: a scalar."""

    name: str
    type: int
    """Boolean, an integer type, Float, Double or String."""
    unit: str | None = None
    range: tuple[float, float] | None = None
    default: SkillValue | None = None
    """None: it has to be given."""
    description: str = ""

    @property
    def typed_default(self) -> SkillValue | None:
        """The default as a value of the type: YAML writes 0 where a Double is meant."""
        is_float = self.type in (BuiltinType.FLOAT, BuiltinType.DOUBLE)
        return self.default if self.default is None or not is_float else float(self.default)


@dataclass(frozen=True, slots=True)
class SkillLimits:
    """What a skill takes at most."""

    least_interval_s: float = 0.0
    """Least time between two requests."""
    largest_message_bytes: int = 65_507
    requests_at_once: int = 1
    """Executions that may be under way; further requests are refused."""
    most_requestors: int = 16
    """Different requestors that are remembered at a time."""
    visible_to: tuple[int, ...] | None = None
    """Spaces that may see and request it; None: all that may command the robot."""


@dataclass(frozen=True, slots=True)
class SkillModel:
    """One skill of one robot."""

    id: int
    """Numeric id in the fleet's namespace: DataSetWriterId of its Action."""
    name: str
    capacities: tuple[str, ...] = ()
    """What a robot needs to have the skill."""
    arguments: tuple[ArgumentModel, ...] = ()
    results: tuple[ArgumentModel, ...] = ()
    timeout_s: float = 60.0
    """After so long an execution is given up."""
    immediate: bool = False
    """Whether it is over at once, so that the answer brings its results."""
    limits: SkillLimits = SkillLimits()
    description: str = ""

    def filled(self, given: Mapping[str, SkillValue]) -> dict[str, SkillValue]:
        """The arguments in their order, defaults in place of what was not given. Check them before."""
        values = ((argument.name, given.get(argument.name, argument.default)) for argument in self.arguments)
        return {name: value for name, value in values if value is not None}

    def argument(self, name: str) -> ArgumentModel | None:
        """An argument by its name."""
        return next((argument for argument in self.arguments if argument.name == name), None)


def in_unit_of(argument: ArgumentModel, value: float, unit: str) -> float:
    """A number that was written with a unit, in the unit of an argument.

    Raises:
        UnitsDiffer: the units do not fit, or the argument has none.
    """
    if argument.unit is None:
        raise UnitsDiffer(f"{argument.name} has no unit, and {value:g} {unit} was given")
    try:
        return convert(value, unit, argument.unit)
    except UnitsDiffer as error:
        raise UnitsDiffer(f"{argument.name}: {error}") from None


def argument_problem(argument: ArgumentModel, value: Any) -> str | None:
    """Why a value is no legal one for an argument, or None."""
    name = argument.name
    wrong = _wrong_type(argument.type, value)
    if wrong is not None:
        return f"{name} is {value!r}; {wrong}"
    if argument.range is not None and isinstance(value, int | float):
        least, greatest = argument.range
        if not least <= value <= greatest:
            of_unit = f" {argument.unit}" if argument.unit else ""
            return f"{name} is {value:g}{of_unit}; legal is {least:g} to {greatest:g}{of_unit}"
    return None


def _wrong_type(code: int, value: Any) -> str | None:
    if code == BuiltinType.BOOLEAN:
        return None if isinstance(value, bool) else "it has to be true or false"
    if code == BuiltinType.STRING:
        return None if isinstance(value, str) else "it has to be a text"
    if isinstance(value, bool) or not isinstance(value, int | float) or not is_finite(value):
        return "it has to be a number"
    if code in _FLOATS:
        return None
    least, greatest = INTEGER_RANGES[code]
    if value != int(value):
        return "it has to be a whole number"
    return None if least <= value <= greatest else f"{BuiltinType(code).name} goes from {least} to {greatest}"


def call_problems(skill: SkillModel, given: Mapping[str, Any]) -> list[str]:
    """Everything that is wrong with the arguments of a call."""
    known = {argument.name: argument for argument in skill.arguments}
    problems = [f"{skill.name} has no argument {name!r}" for name in given if name not in known]
    for name, argument in known.items():
        if name in given:
            problem = argument_problem(argument, given[name])
            if problem is not None:
                problems.append(problem)
        elif argument.default is None:
            problems.append(f"the argument {name!r} of {skill.name} is missing")
    return problems
