"""By what candidates are compared, and what a raw value is worth beside the others."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

__all__ = ["Criterion", "CriterionKind", "Missing", "availability"]

_LEAST_COST: Final = 0.01
"""Of a criterion's range: below it one cost is as good as another, and none is divided by zero."""
_FAR: Final = 1_000.0
"""Times the greater end of a criterion's range: a value beyond it is a mistake of who says it."""
_SMALLEST, _LARGEST = 1e-100, 1e100
"""Between them no sum and no quotient of values leaves what a double holds."""


class CriterionKind(StrEnum):
    """Whether more is better."""

    BENEFIT = "benefit"
    COST = "cost"


class Missing(StrEnum):
    """What it means for a candidate that its value is not known."""

    EXCLUDE = "exclude"
    """It gives way to those of which everything is known that must be; without any of these it counts as the worst."""
    WORST = "worst"
    """It counts as the worst end of the range, or as the worst of the others where that is worse."""
    NEUTRAL = "neutral"
    """The criterion speaks neither for the candidate nor against it: it is worth what the others are in the mean."""


@dataclass(frozen=True, slots=True)
class Criterion:
    """One criterion: a raw value of each candidate."""

    name: str
    kind: CriterionKind
    range: tuple[float, float]
    """Least and greatest value that is to be expected."""
    unit: str = ""
    missing: Missing = Missing.WORST
    capacities: tuple[str, ...] = ()
    skills: tuple[str, ...] = ()
    """It counts for tasks that need one of these capacities, or are one of these skills. Neither given: for all."""

    def __post_init__(self) -> None:
        least, greatest = self.range
        if not (math.isfinite(least) and math.isfinite(greatest) and least < greatest):
            raise ValueError(f"{self.name}: the range {self.range} is not from a number to a greater one")
        if max(-least, greatest) > _LARGEST or greatest - least < _SMALLEST:
            raise ValueError(f"{self.name}: the range {self.range} is not between -{_LARGEST:g} and {_LARGEST:g}")

    def is_about(self, skill: str, capacities: Collection[str]) -> bool:
        """Whether it counts for a task.

        Args:
            skill: what is done.
            capacities: what that needs.
        """
        if not self.capacities and not self.skills:
            return True
        return skill in self.skills or any(capacity in capacities for capacity in self.capacities)

    def objection(self, value: float) -> str | None:
        """Why a raw value cannot be compared, or None."""
        if not math.isfinite(value):
            return f"{self.name} is {value}"
        if abs(value) > _FAR * max(map(abs, self.range)):
            return f"{self.name} is {value:g}, which is far outside of {self.range[0]:g} to {self.range[1]:g}"
        if value < 0 and self.kind is CriterionKind.BENEFIT:
            return f"{self.name} is {value:g}{self.unit and ' ' + self.unit}, and a benefit is never below 0"
        return None

    def scores(self, values: Sequence[float]) -> tuple[float, ...]:
        """Each value's share of 1: v / sum(v) for a benefit; for a cost the same of 1 / max(v, 1 % of the range).

        Where all benefits are 0, nobody is better than another and the shares are equal.
        """
        if self._is_cost:
            values = [1 / self._cost(value) for value in values]
        total = math.fsum(values)
        if total == 0:
            return (1 / len(values),) * len(values) if values else ()
        return tuple(value / total for value in values)

    def stand_in(self, known: Sequence[float]) -> float:
        """What counts in the place of a value that is missing, beside those that are known."""
        least, greatest = self.range
        if self.missing is not Missing.NEUTRAL:
            return max(greatest, *known, 0.0) if self._is_cost else max(min(least, *known, greatest), 0.0)
        if not known:
            return max((least + greatest) / 2, 0.0)
        if self._is_cost:  # the cost that is worth what the others are in the mean
            return len(known) / math.fsum(1 / self._cost(value) for value in known)
        return math.fsum(known) / len(known)

    @property
    def _is_cost(self) -> bool:
        return self.kind is CriterionKind.COST

    def _cost(self, value: float) -> float:
        return max(value, _LEAST_COST * (self.range[1] - self.range[0]))


def availability(tasks_ahead: int) -> float:
    """100 for a robot without tasks ahead; each task takes away something, less each time, so that it stays above 0."""
    return 100.0 / (1 + tasks_ahead)
