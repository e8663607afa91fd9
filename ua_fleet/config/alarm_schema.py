"""`limits` and `normal` in `fleet.yaml`: which values are alarms."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

from pydantic import Field, model_validator

from ua_fleet.config.base import Model, Name

__all__ = ["AlarmConfig", "LimitsConfig", "NormalConfig", "limits_problem"]

Limit = Annotated[float, Field(allow_inf_nan=False)]


class AlarmConfig(Model, frozen=True):
    """What all alarms of values have."""

    delay_s: float = Field(default=0, ge=0, le=1e6, allow_inf_nan=False)
    """For so long a value has to be beyond before that is an alarm. It ends without a delay."""
    severity: int = Field(default=500, ge=1, le=1000)
    """Severity of the alarm, 1 to 1000; of `high_high` and `low_low` 200 more."""
    confirm: bool = False
    """Whether somebody has to confirm it (Confirm) after it was acknowledged, e.g. when the cause is mended."""
    fault: tuple[Name, ...] | bool = False
    """Capacities of the robot that it takes away while it is active, as a fault does; `true`: all of them."""


class LimitsConfig(AlarmConfig, frozen=True):
    """Limits of a number, in its unit: an alarm of type ExclusiveLevelAlarmType."""

    high: Limit | None = None
    """A value above it is an alarm."""
    high_high: Limit | None = None
    """A value above it is one of more severity; greater than `high`."""
    low: Limit | None = None
    """A value below it is an alarm."""
    low_low: Limit | None = None
    """A value below it is one of more severity; less than `low`."""
    hysteresis: float = Field(default=0, ge=0, allow_inf_nan=False)
    """How far a value has to come back over a limit until that is over. Less than the distance of two limits."""

    @model_validator(mode="after")
    def _check(self) -> LimitsConfig:
        given = [self.low_low, self.low, self.high, self.high_high]
        limits = [limit for limit in given if limit is not None]
        if not limits:
            raise ValueError("give at least one of high, high_high, low and low_low")
        for lower, upper in pairwise(limits):
            if lower >= upper:
                raise ValueError(f"{lower:g} must be less than {upper:g}: low_low < low < high < high_high")
            if upper - lower <= self.hysteresis:
                raise ValueError(
                    f"{lower:g} and {upper:g} are nearer to each other than the hysteresis {self.hysteresis:g}"
                )
        return self


class NormalConfig(AlarmConfig, frozen=True):
    """The value that a Boolean has normally: any other one is an alarm of type OffNormalAlarmType."""

    value: bool
    """It."""


def limits_problem(limits: LimitsConfig, value_range: tuple[float, float] | None) -> str:
    """Why limits do not fit the range of a value, if that has one; empty where they do.

    Of a value without a range nobody knows whether it goes to the other side of 0, where an alarm would end whose limit
    is below its hysteresis: most numbers (a speed, a current, a level) do not.
    """
    for name in ("high", "high_high", "low", "low_low"):
        limit: float | None = getattr(limits, name)
        if limit is None:
            continue
        back = limit - limits.hysteresis if name.startswith("high") else limit + limits.hysteresis
        if value_range is None:
            if limit * back < 0:
                return (
                    f"{name} {limit:g} is below the hysteresis {limits.hysteresis:g}, and its alarm would end only at"
                    f" {back:g}; give the value a range with {back:g} in it, or a smaller hysteresis"
                )
            continue
        least, greatest = value_range
        if not least <= limit <= greatest:
            return f"{name} {limit:g} is outside the range {least:g} to {greatest:g}"
        if not least <= back <= greatest:
            return f"the alarm of {name} would end only at {back:g}, outside the range {least:g} to {greatest:g}"
    return ""
