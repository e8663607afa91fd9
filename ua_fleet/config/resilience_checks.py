"""`resilience` held against the robots: names that lead nowhere, and judgements that come to no weights."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from ua_fleet.config.parts import Parts
from ua_fleet.config.resilience_schema import RESERVED_SOURCES, CriterionConfig, FaultConditionConfig
from ua_fleet.config.schema import FieldConfig, ScalarType
from ua_fleet.document import KeyPath
from ua_fleet.errors import JudgementsInvalid
from ua_fleet.names import closest, listed
from ua_fleet.scenario import split_index

__all__ = ["capacities_of", "check_resilience"]

_PATH: Final[KeyPath] = ("resilience",)
_NO_VALUES: Final = (ScalarType.DATETIME, ScalarType.BYTE_STRING)
"""Types of which no condition and no criterion can be."""
_NO_NUMBERS: Final = (*_NO_VALUES, ScalarType.BOOLEAN, ScalarType.STRING)


class _Values:
    """The values of robots, by the names that conditions and criteria use."""

    def __init__(self, parts: Parts) -> None:
        self.robots = list(parts.mapping_at(("robots",)))
        self._doubtful: set[tuple[str, str]] = set()
        """Data that has problems of its own."""
        self._fields: dict[str, dict[str, FieldConfig]] = {robot: {} for robot in self.robots}
        for robot in self.robots:
            for name in parts.mapping_at(("robots", robot, "data")):
                data_set = parts.data.get((robot, name))
                if data_set is None:
                    self._doubtful.add((robot, name))
                    continue
                for field_name, field in data_set.all_fields().items():
                    self._fields[robot][f"{name}.{field_name}" if field_name else name] = field

    def problem(self, robot: str, name: str, unfit: tuple[ScalarType, ...]) -> tuple[str, str] | None:
        """Why a robot has no such value, and a hint; None where it has one, or nobody can say.

        Args:
            robot: its name.
            name: with an index where one element of an array is meant.
            unfit: types that it must not have.
        """
        if robot not in self._fields or (robot, name.partition(".")[0].partition("[")[0]) in self._doubtful:
            return None
        own, index = split_index(name)
        field = self._fields[robot].get(own)
        if field is None:
            known = self._fields[robot]
            return f"{robot} has no value `{own}`", closest(own, known) or f"it has: {listed(known) or 'none'}"
        if field.array != (index is not None):
            hint = f"write {own}[0] for its first element" if field.array else f"write {own}"
            return f"`{own}` of {robot} is {'an' if field.array else 'no'} array", hint
        if field.type in unfit:
            return f"`{own}` of {robot} is a {field.type.value}, which cannot be used here", ""
        return None


def check_resilience(parts: Parts) -> None:
    """Note what is wrong with criteria, judgements and conditions of faults."""
    resilience = parts.resilience
    if resilience is None:
        return
    is_whole = not any(problem.key.startswith("resilience") for problem in parts.document.problems)
    values = _Values(parts)
    capacities = {each for robot in parts.robots.values() for each in robot.capacities}
    capacities |= {each for data_set in parts.data.values() for each in data_set.gives}
    skills = {each for robot in parts.robots.values() for each in robot.skills}
    for name, criterion in resilience.criteria.items():
        path: KeyPath = (*_PATH, "criteria", name)
        _check_criterion(parts, values, path, criterion)
        if parts.robots:
            _check_named(parts, (*path, "capacities"), "no robot has the capacity", criterion.capacities, capacities)
            _check_named(parts, (*path, "skills"), "no robot has the skill", criterion.skills, skills)
    able = capacities_of(parts)
    for name, fault in resilience.faults.items():
        _check_fault(parts, values, able, (*_PATH, "faults", name), name, fault)
    if is_whole:
        try:
            resilience.settings()
        except JudgementsInvalid as error:
            for problem in error.problems:
                parts.document.problem((*_PATH, "judgements"), problem)


def _check_criterion(parts: Parts, values: _Values, path: KeyPath, criterion: CriterionConfig) -> None:
    """Some robots may lack a value; one that all lack is a mistake."""
    distance = criterion.distance
    named: list[tuple[KeyPath, str]] = []
    if criterion.value is not None:
        named.append(((*path, "value"), criterion.value))
    if distance is not None:
        named += [((*path, "distance", "x"), distance.x), ((*path, "distance", "y"), distance.y)]
    for where, name in named:
        said = [values.problem(robot, name, _NO_NUMBERS) for robot in values.robots]
        problems = [problem for problem in said if problem is not None]
        if problems and len(problems) == len(said):
            (text, hint), *others = problems
            parts.document.problem(where, f"no robot has a number `{name}`: {text}" if others else text, hint)
    if distance is None:
        return
    arguments = {name for robot in parts.robots.values() for skill in robot.skills.values() for name in skill.arguments}
    has_skills = any(robot.skills for robot in parts.robots.values())
    if distance.argument is not None and has_skills and distance.argument not in arguments:
        text = f"no skill has an argument `{distance.argument}`"
        parts.document.problem((*path, "distance", "argument"), text, closest(distance.argument, arguments))
    if (distance.argument is None) != (not distance.places):
        there, missing = ("places", "argument") if distance.places else ("argument", "places")
        text = f"`{there}` is without use where `{missing}` is missing"
        parts.document.problem((*path, "distance", there), text, f"add `{missing}`, or remove it")


def capacities_of(parts: Parts) -> dict[str, set[str]]:
    """What each robot can do, always or while its data is there, or that of what is mounted on it."""
    able = {name: set(robot.capacities) for name, robot in parts.robots.items()}
    for (giver, _), data in parts.data.items():
        robot = parts.robots.get(giver)
        for name in (giver, robot.mounted_on if robot is not None else None):
            if name is not None and data.gives:
                able.setdefault(name, set()).update(data.gives)
    return able


def _check_named(parts: Parts, path: KeyPath, problem: str, names: Iterable[str], known: set[str]) -> None:
    for position, name in enumerate(names):
        if name not in known:
            hint = closest(name, known) or f"known: {listed(sorted(known)) or 'none'}"
            parts.document.problem((*path, position), f"{problem} `{name}`", hint)


def _check_fault(
    parts: Parts,
    values: _Values,
    all_able: Mapping[str, set[str]],
    path: KeyPath,
    name: str,
    fault: FaultConditionConfig,
) -> None:
    if name in RESERVED_SOURCES:
        parts.document.problem(path, f"`{name}` is found by the program itself", "choose another name")
    for position, robot in enumerate(fault.robots):
        if robot not in values.robots:
            hint = closest(robot, values.robots) or f"robots: {listed(values.robots) or 'none'}"
            parts.document.problem((*path, "robots", position), f"there is no robot `{robot}`", hint)
        else:
            able = all_able.get(robot, set())
            for at, capacity in enumerate(fault.capacities):
                if capacity not in able:
                    hint = closest(capacity, able) or f"it has: {listed(sorted(able)) or 'none'}"
                    parts.document.problem((*path, "capacities", at), f"{robot} lacks the capacity `{capacity}`", hint)
    rule = fault.rule(name)
    for key, expression in (("when", rule.when), ("until", rule.until)):
        if expression is not None:
            for text, hint in _unknown(values, fault.robots, sorted(expression.names)):
                parts.document.problem((*path, key), text, hint)


def _unknown(values: _Values, robots: Iterable[str], names: Iterable[str]) -> Iterator[tuple[str, str]]:
    """A name is a value of the robot itself, or with a robot's name before it of that one."""
    for name in names:
        owner, _, rest = name.partition(".")
        for robot in robots:
            problem = values.problem(robot, name, _NO_VALUES)
            if problem is not None and rest and owner in values.robots:
                problem = values.problem(owner, rest, _NO_VALUES)
            if problem is not None:
                yield problem
