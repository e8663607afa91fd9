"""Alarms of values held against the robots: the capacities that they take away."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from ua_fleet.config.alarm_schema import AlarmConfig, NormalConfig
from ua_fleet.config.parts import Parts
from ua_fleet.config.resilience_checks import capacities_of
from ua_fleet.config.schema import DataSetConfig, FieldConfig, value_name
from ua_fleet.document import KeyPath, key_text
from ua_fleet.names import closest, listed

__all__ = ["BRIDGE_AWAY", "alarm_of", "alarms_of", "check_alarms"]

BRIDGE_AWAY: Final = "Online"
"""What an alarm is of that says that a bridge is away."""


def alarm_of(field: FieldConfig) -> AlarmConfig | None:
    """The alarm of a field; None where it has none."""
    if field.limits is not None:
        return field.limits
    return NormalConfig(value=field.normal) if isinstance(field.normal, bool) else field.normal


def alarms_of(data: DataSetConfig) -> Iterator[tuple[KeyPath, str, FieldConfig, AlarmConfig]]:
    """The fields of a data source with alarms: where the alarm stands below it, the field, and the alarm."""
    if not data.fields and data.limits is None and data.normal is None:
        return  # as of nearly all
    for name, field in data.all_fields().items():
        if (alarm := alarm_of(field)) is not None:
            key = "limits" if field.limits is not None else "normal"
            yield (("fields", name, key) if name else (key,)), name, field, alarm


def check_alarms(parts: Parts) -> None:
    """Note alarms that have the name of another one, or take away what their robot does not have."""
    _check_names(parts)
    able_robots = capacities_of(parts)
    for (robot, name), data in parts.data.items():
        able = able_robots.get(robot, set())
        for path, _, _, alarm in alarms_of(data):
            if isinstance(alarm.fault, bool):
                continue
            for position, capacity in enumerate(alarm.fault):
                if capacity not in able:
                    hint = closest(capacity, able) or f"it has: {listed(sorted(able)) or 'none'}"
                    where: KeyPath = ("robots", robot, "data", name, *path, "fault", position)
                    parts.document.problem(where, f"{robot} lacks the capacity `{capacity}`", hint)


def _check_names(parts: Parts) -> None:
    """Note alarms whose ConditionId another one has: it would replace them."""
    owners: dict[str, KeyPath] = {f"{bridge}.{BRIDGE_AWAY}": ("bridges", bridge) for bridge in parts.bridges}
    for (robot, name), data in parts.data.items():
        for path, field, _, _ in alarms_of(data):
            where: KeyPath = ("robots", robot, "data", name, *path)
            alarm_id = f"{robot}.{value_name(name, field)}"
            if (other := owners.setdefault(alarm_id, where)) != where:
                line = parts.document.place_of(other).line
                message = f"`{alarm_id}` is an alarm of {key_text(other)}{f' (line {line})' if line else ''} already"
                parts.document.problem(where, message, "name one of them otherwise")
