"""The parameters that a run is started with, and the arguments that robots are asked with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ua_fleet.errors import ScenarioInvalid
from ua_fleet.fleet.quantities import UnitsDiffer
from ua_fleet.fleet.skills import SkillModel, call_problems, in_unit_of
from ua_fleet.scenario.expression import Expression, Lookup, Value, ValueUnknown
from ua_fleet.scenario.model import Argument, Scenario, Task
from ua_fleet.values import BuiltinType, is_finite

__all__ = ["argument_problems", "arguments_for", "checked_parameters", "known_arguments"]


def arguments_for(task: Task, skill: SkillModel | None, lookup: Lookup) -> dict[str, Value]:
    """The arguments that a robot is asked with: computed, in the units of its own skill, with its own defaults.

    Raises:
        ValueUnknown: an expression has no value now.
    """
    given = {
        name: value.value(lookup) if isinstance(value, Expression) else value for name, value in task.arguments.items()
    }
    if skill is None:
        return given
    given |= _converted(task, skill)[0]
    return skill.filled(given) | given


def _converted(task: Task, skill: SkillModel) -> tuple[dict[str, float], dict[str, str]]:
    """Arguments with units in those of a skill; and those that do not fit, with the reason."""
    ready: dict[str, float] = {}
    problems: dict[str, str] = {}
    for name, (number, unit) in task.quantities.items():
        argument = skill.argument(name)
        if argument is None or argument.type == BuiltinType.STRING:
            continue
        try:
            ready[name] = in_unit_of(argument, number, unit)
        except UnitsDiffer as error:
            problems[name] = str(error)
    return ready, problems


def argument_problems(skill: SkillModel, given: Mapping[str, Argument], task: Task) -> list[str]:
    """Everything that is wrong with the arguments of a task for one robot's skill.

    Args:
        skill: the robot's declaration.
        given: what is known of them; the others, and expressions, are computed later.
        task: the task.
    """
    ready, units = _converted(task, skill)
    values = {name: value for name, value in given.items() if not isinstance(value, Expression) and name not in units}
    values |= ready
    later = task.arguments.keys() - values.keys()
    declared = {argument.name for argument in skill.arguments}
    rest = replace(skill, arguments=tuple(argument for argument in skill.arguments if argument.name not in later))
    unknown = [f"{skill.name} has no argument {name!r}" for name in later - declared]
    return [*units.values(), *unknown, *call_problems(rest, values)]


def known_arguments(task: Task, lookup: Lookup) -> dict[str, Value]:
    """The arguments of a task as far as they are known before its turn comes."""
    known: dict[str, Value] = {}
    for name, value in task.arguments.items():
        try:
            known[name] = value.value(lookup) if isinstance(value, Expression) else value
        except ValueUnknown:
            continue
    return known


def checked_parameters(scenario: Scenario, given: Mapping[str, Value]) -> dict[str, Value]:
    """All parameters of a scenario with the values given, or their defaults.

    Raises:
        ScenarioInvalid: with every parameter that is missing, unknown, of another kind or out of its range.
    """
    known = {parameter.name: parameter for parameter in scenario.parameters}
    problems = [f"there is no parameter {name!r}" for name in given if name not in known]
    values: dict[str, Value] = {}
    for name, parameter in known.items():
        value = given.get(name, parameter.default)
        if value is None:
            problems.append(f"the parameter {name!r} is missing")
            continue
        default, limits = parameter.default, parameter.range
        if not isinstance(value, str) and not is_finite(value):
            problems.append(f"the parameter {name!r} is {str(value)[:40]}, and no number")
            continue
        if default is not None and _kind(value) is not _kind(default):
            problems.append(f"the parameter {name!r} is {value!r}, and its default {default!r} is of another kind")
        elif limits is not None and (isinstance(value, bool | str) or not limits[0] <= value <= limits[1]):
            problems.append(f"the parameter {name!r} is {value!r}; legal is {limits[0]:g} to {limits[1]:g}")
        values[name] = value
    if problems:
        raise ScenarioInvalid(problems)
    return values


def _kind(value: Value) -> type[Value]:
    return float if type(value) is int else type(value)
