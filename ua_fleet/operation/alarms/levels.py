"""In which level of its limits a value is (ExclusiveLevelAlarmType, OPC 10000-9 5.8.21).

A limit is exceeded by what is beyond it; the level ends when the value is back by the hysteresis. Between the two, and
within a level, nothing changes: `band` tells how far that goes, so that most values cost one comparison.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import inf, nextafter

__all__ = ["Level", "Levels"]


class Level(IntEnum):
    """States of ExclusiveLimitStateMachineType, and none of them."""

    LOW_LOW = -2
    LOW = -1
    NORMAL = 0
    HIGH = 1
    HIGH_HIGH = 2


@dataclass(frozen=True, slots=True)
class Levels:
    """The limits of one value, in its unit; infinite where there is none."""

    high: float = inf
    high_high: float = inf
    low: float = -inf
    low_low: float = -inf
    hysteresis: float = 0.0
    """How far a value has to come back over a limit until that is over."""

    def level(self, value: float, before: Level) -> Level:
        """The level of a value where the one before had another."""
        back = self.hysteresis
        if value > self.high_high or (before is Level.HIGH_HIGH and value > self.high_high - back):
            return Level.HIGH_HIGH
        if value > self.high or (before > Level.NORMAL and value > self.high - back):
            return Level.HIGH
        if value < self.low_low or (before is Level.LOW_LOW and value < self.low_low + back):
            return Level.LOW_LOW
        if value < self.low or (before < Level.NORMAL and value < self.low + back):
            return Level.LOW
        return Level.NORMAL

    def band(self, level: Level) -> tuple[float, float]:
        """The least and the greatest value with which a level stays as it is."""
        back = self.hysteresis
        match level:
            case Level.HIGH_HIGH:
                return nextafter(self.high_high - back, inf), inf
            case Level.HIGH:
                return nextafter(self.high - back, inf), self.high_high
            case Level.LOW:
                return self.low_low, nextafter(self.low + back, -inf)
            case Level.LOW_LOW:
                return -inf, nextafter(self.low_low + back, -inf)
            case _:
                return self.low, self.high
