"""The unit in which people read each criterion: what it says itself, or what the values have that it is made of."""

from __future__ import annotations

from dataclasses import replace
from typing import assert_never

from ua_fleet.config.schema import FleetConfig, value_name
from ua_fleet.orchestrator import CriterionSource, DistanceFrom, ResilienceSettings, TasksAhead, ValueOf
from ua_fleet.scenario import split_index

__all__ = ["settings_with_units"]


def settings_with_units(config: FleetConfig) -> ResilienceSettings:
    """How replacements are chosen. A criterion of values that have several units has none, as long as it says none."""
    settings = config.resilience.settings()
    units: dict[str, set[str]] = {}
    is_needed = any(map(_names, [source for _, source in settings.criteria]))
    for robot in config.robots.values() if is_needed else ():
        for data, data_set in robot.data.items():
            for field_name, field in data_set.all_fields().items():
                units.setdefault(value_name(data, field_name), set()).add(field.unit or "")
    return replace(
        settings,
        criteria=tuple(
            (replace(criterion, unit=criterion.unit or _common(source, units)), source)
            for criterion, source in settings.criteria
        ),
    )


def _names(source: CriterionSource) -> list[str]:
    """The values that a criterion is made of."""
    match source:
        case ValueOf(name):
            return [name]
        case DistanceFrom():
            return [source.x, source.y]
        case TasksAhead():
            return []
        case _:
            assert_never(source)


def _common(source: CriterionSource, units: dict[str, set[str]]) -> str:
    found = {unit for name in _names(source) for unit in units.get(split_index(name)[0], ())}
    return found.pop() if len(found) == 1 else ""
