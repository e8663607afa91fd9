"""The parameters that a run is started with, and arguments that follow from them."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ua_fleet.errors import ScenarioInvalid
from ua_fleet.scenario.expression import Expression, Lookup, Value, ValueUnknown
from ua_fleet.scenario.model import Scenario, Task

__all__ = ["checked_parameters", "known_arguments"]


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
        if isinstance(value, float) and not math.isfinite(value):
            problems.append(f"the parameter {name!r} is {value}, and no number")
        if default is not None and isinstance(value, str) != isinstance(default, str):
            problems.append(f"the parameter {name!r} is {value!r}, and its default {default!r} is of another kind")
        elif limits is not None and not (isinstance(value, int | float) and limits[0] <= value <= limits[1]):
            problems.append(f"the parameter {name!r} is {value!r}; legal is {limits[0]:g} to {limits[1]:g}")
        values[name] = value
    if problems:
        raise ScenarioInvalid(problems)
    return values
