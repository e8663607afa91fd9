"""By what candidates are compared, and what a raw value is worth beside the others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

__all__ = ["Criterion", "CriterionKind", "availability"]

_LEAST_COST: Final = 0.01
"""Of a criterion's range: below it one cost is as good as another, and none is divided by zero."""


class CriterionKind(StrEnum):
    """Whether more is better."""

    BENEFIT = "benefit"
    COST = "cost"


@dataclass(frozen=True, slots=True)
class Criterion:
    """One criterion: a raw value of each candidate."""

    name: str
    kind: CriterionKind
    range: tuple[float, float]
    """Least and greatest value that is to be expected."""
    unit: str = ""

    def __post_init__(self) -> None:
        least, greatest = self.range
        if not (math.isfinite(least) and math.isfinite(greatest) and least < greatest):
            raise ValueError(f"{self.name}: the range {self.range} is not from a number to a greater one")

    def objection(self, value: float) -> str | None:
        """Why a raw value cannot be compared, or None."""
        if not math.isfinite(value):
            return f"{self.name} is {value}"
        if value < 0 and self.kind is CriterionKind.BENEFIT:
            return f"{self.name} is {value:g}{self.unit and ' ' + self.unit}, and a benefit is never below 0"
        return None

    def scores(self, values: Sequence[float]) -> tuple[float, ...]:
        """Each value's share of 1: v / sum(v) for a benefit; for a cost the same of 1 / max(v, 1 % of the range).

        Where all benefits are 0, nobody is better than another and the shares are equal.
        """
        if self.kind is CriterionKind.COST:
            least = _LEAST_COST * (self.range[1] - self.range[0])
            values = [1 / max(value, least) for value in values]
        total = math.fsum(values)
        if total == 0:
            return (1 / len(values),) * len(values) if values else ()
        return tuple(value / total for value in values)


def availability(tasks_ahead: int) -> float:
    """100 for a robot without tasks ahead; each task takes away something, less each time, so that it stays above 0."""
    return 100.0 / (1 + tasks_ahead)
