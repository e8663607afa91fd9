"""From setpoint to setpoint within speed, acceleration and jerk, in steps of a fixed period.

The setpoint of an axis is a speed v with a slope a. In each period the slope changes by at most q = jerk * period, and
v by slope * period. From a slope of a = k*q the slope is let go in k + 1 periods, in which v goes on by

    S(a) = period * (a + (a - q) + ... + (a - k*q)) = period * ((k + 1)*a - q*k*(k + 1)/2),  k = floor(a / q)

S rises with a and is piecewise linear, so it has an inverse. Each step takes the greatest slope whose S does not go
beyond the target. The one before did too, less q: S(a) = a*period + S(a - q). So the target is met exactly, with the
slope let go, and it is never passed. Only a target that is moved nearer than S of the slope that there is, or to the
other side, is passed, by what that slope takes to be let go; never a limit of speed, since the old target kept to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ua_fleet.teleoperation.model import AxisLimits

__all__ = ["AxisRamp", "Ramp"]


class AxisRamp:
    """The output of one axis."""

    __slots__ = ("_limits", "_nearly", "_period_s", "_step", "slope", "value")

    def __init__(self, limits: AxisLimits, period_s: float) -> None:
        """Begin at rest."""
        self._limits, self._period_s = limits, period_s
        self._step = limits.jerk * period_s
        self._nearly = 1e-9 * limits.speed
        self.value = 0.0
        """What is written to the robot."""
        self.slope = 0.0
        """Its change in a second."""

    def follow(self, target: float) -> None:
        """Go one period towards a target, which is held within the limit of speed."""
        speed = self._limits.speed
        self._go(min(max(target, -speed), speed), self._limits.acceleration)

    def brake(self) -> None:
        """Go one period towards zero, with the deceleration of a stop."""
        self._go(0.0, self._limits.deceleration)

    def rest(self) -> None:
        """Be at rest from now on: the robot has stopped by itself."""
        self.value = self.slope = 0.0

    @property
    def is_at_rest(self) -> bool:
        """Whether it is zero and stays so."""
        return not self.value and not self.slope

    def _go(self, target: float, most: float) -> None:
        distance = target - self.value
        step = self._step
        if abs(distance) <= self._nearly and abs(self.slope) <= step:
            self.value, self.slope = target, 0.0
            return
        wanted = math.copysign(min(self._greatest_slope(abs(distance)), most), distance)
        self.slope = min(max(wanted, self.slope - step), self.slope + step)
        self.value += self.slope * self._period_s
        if abs(target - self.value) <= self._nearly:
            self.value = target

    def _greatest_slope(self, distance: float) -> float:
        """The inverse of S."""
        steps = distance / (self._period_s * self._step)
        whole = math.floor((math.sqrt(1 + 8 * steps) - 1) / 2)
        return self._step * (steps + whole * (whole + 1) / 2) / (whole + 1)


class Ramp:
    """The outputs of all axes of a robot."""

    def __init__(self, limits: Sequence[AxisLimits], period_s: float) -> None:
        """Begin at rest."""
        self._axes = [AxisRamp(each, period_s) for each in limits]

    @property
    def values(self) -> tuple[float, ...]:
        """What is written to the robot."""
        return tuple([axis.value for axis in self._axes])

    @property
    def is_at_rest(self) -> bool:
        """Whether all are zero and stay so."""
        return all(axis.is_at_rest for axis in self._axes)

    def follow(self, targets: Sequence[float]) -> None:
        """Go one period towards the setpoints."""
        for axis, target in zip(self._axes, targets, strict=True):
            axis.follow(target)

    def brake(self) -> None:
        """Go one period towards a standstill."""
        for axis in self._axes:
            axis.brake()

    def rest(self) -> None:
        """Be at rest from now on."""
        for axis in self._axes:
            axis.rest()
