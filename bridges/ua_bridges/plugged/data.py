"""The values of plugged-in devices. Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ua_fleet.bridge.driver import DriverEvent
from ua_fleet.config.base import ScalarType
from ua_fleet.fleet.skills import ArgumentModel, argument_problem

__all__ = ["Put", "as_type"]

Put = Callable[[DriverEvent], None]
_FLOATS = (ScalarType.FLOAT, ScalarType.DOUBLE)


def as_type(name: str, kind: ScalarType, value: Any) -> Any:
    """A value as its field's type has it, a ValueError in its place where that cannot hold it."""
    if kind in _FLOATS and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    problem = argument_problem(ArgumentModel(name, int(kind.builtin)), value)
    return value if problem is None else ValueError(problem)
