"""Units that people write beside numbers, and how one becomes another of its kind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from ua_fleet.errors import UaFleetError
from ua_fleet.names import closest
from ua_fleet.values import StatusCode

__all__ = ["UNITS", "UnitsDiffer", "convert"]

UNITS: Final[Mapping[str, tuple[str, float, float]]] = {
    # unit: what it measures, factor, offset; value * factor + offset is in the unit of that kind with 1 and 0
    **dict.fromkeys(("m",), ("length", 1.0, 0.0)),
    "mm": ("length", 1e-3, 0.0),
    "cm": ("length", 1e-2, 0.0),
    "km": ("length", 1e3, 0.0),
    "rad": ("angle", 1.0, 0.0),
    **dict.fromkeys(("deg", "°"), ("angle", math.pi / 180, 0.0)),
    "s": ("time", 1.0, 0.0),
    "ms": ("time", 1e-3, 0.0),
    "min": ("time", 60.0, 0.0),
    "h": ("time", 3600.0, 0.0),
    "m/s": ("speed", 1.0, 0.0),
    "mm/s": ("speed", 1e-3, 0.0),
    "km/h": ("speed", 1 / 3.6, 0.0),
    "rad/s": ("rotation", 1.0, 0.0),
    "deg/s": ("rotation", math.pi / 180, 0.0),
    **dict.fromkeys(("rpm", "1/min"), ("rotation", math.tau / 60, 0.0)),
    "K": ("temperature", 1.0, 0.0),
    **dict.fromkeys(("°C", "degC"), ("temperature", 1.0, 273.15)),
    **dict.fromkeys(("°F", "degF"), ("temperature", 5 / 9, 459.67 * 5 / 9)),
    "kg": ("mass", 1.0, 0.0),
    "g": ("mass", 1e-3, 0.0),
    "t": ("mass", 1e3, 0.0),
    "N": ("force", 1.0, 0.0),
    "kN": ("force", 1e3, 0.0),
    "Nm": ("torque", 1.0, 0.0),
    "Pa": ("pressure", 1.0, 0.0),
    "bar": ("pressure", 1e5, 0.0),
    "V": ("voltage", 1.0, 0.0),
    "mV": ("voltage", 1e-3, 0.0),
    "A": ("current", 1.0, 0.0),
    "mA": ("current", 1e-3, 0.0),
    "W": ("power", 1.0, 0.0),
    "kW": ("power", 1e3, 0.0),
    "Hz": ("frequency", 1.0, 0.0),
    "lx": ("illuminance", 1.0, 0.0),
    "%": ("share", 1e-2, 0.0),
    "1": ("share", 1.0, 0.0),
}


class UnitsDiffer(UaFleetError):
    """A unit that is not known, or one that measures something else."""

    ua_status = StatusCode.BAD_INVALID_ARGUMENT
    remedy = "Write a unit of the same quantity (docs/fleet-yaml.md)."


def convert(value: float, unit: str, wanted: str) -> float:
    """A value of `unit` in `wanted`. Units that we do not know are the same only where they are written the same.

    Raises:
        UnitsDiffer: one is unknown, or they measure different things.
    """
    if unit == wanted:
        return value
    for name in (unit, wanted):
        if name not in UNITS:
            hint = closest(name, UNITS)
            raise UnitsDiffer(f"the unit {name!r} is not known{'; ' + hint if hint else ''}")
    kind, factor, offset = UNITS[unit]
    other_kind, other_factor, other_offset = UNITS[wanted]
    if kind != other_kind:
        raise UnitsDiffer(f"{unit} measures {kind}, and {wanted} measures {other_kind}")
    return (value * factor + offset - other_offset) / other_factor
