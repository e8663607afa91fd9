"""Weights from pairwise comparisons: the Analytic Hierarchy Process (T. L. Saaty, 1980).

A judgement says how many times more important one element is than another, from 1/9 to 9. The judgements make a
positive reciprocal matrix A. The weights are its principal eigenvector, and its principal eigenvalue lambda_max, at
least n, measures how well they agree: CI = (lambda_max - n) / (n - 1), and CR = CI / RI with the mean CI of random
matrices. A ratio above 0.1 is refused, with the judgement that disagrees most with the rest: the one whose
a_ij * w_j / w_i lies farthest from 1 (T. L. Saaty, European Journal of Operational Research 145, 2003, p. 85).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

from ua_fleet.errors import JudgementsInvalid

__all__ = ["HIGHEST_CONSISTENCY_RATIO", "MOST_ELEMENTS", "RANDOM_INDEX", "Judgements", "Weights", "weigh"]

Judgements = Mapping[tuple[str, str], float]
"""(a, b) -> how many times more important a is than b. Each pair once; both ways where they are reciprocal."""

RANDOM_INDEX: Final = (
    *(0.0, 0.0, 0.52, 0.89, 1.11),
    *(1.25, 1.35, 1.40, 1.45, 1.49),
    *(1.52, 1.54, 1.56, 1.58, 1.59),
)
"""Saaty's random index for 1 to 15 elements (Theory and Applications of the ANP, 2005, p. 31)."""
MOST_ELEMENTS: Final = len(RANDOM_INDEX)
HIGHEST_CONSISTENCY_RATIO: Final = 0.1

LARGEST_JUDGEMENT: Final = 9.0
_ROUNDING: Final = 1e-3
"""People write 0.333 for 1/3: so far may a judgement lie beyond the scale, or two differ from being reciprocal."""
_PRECISION: Final = 1e-13
_MOST_STEPS: Final = 10_000

_Matrix = list[list[float]]


@dataclass(frozen=True, slots=True)
class Weights:
    """What judgements come to. `weights` are in the order of `names`, and their sum is 1."""

    names: tuple[str, ...]
    weights: tuple[float, ...]
    lambda_max: float
    consistency_ratio: float

    def of(self, name: str) -> float:
        """The weight of one element."""
        return self.weights[self.names.index(name)]

    def among(self, names: Collection[str]) -> Weights:
        """The weights where only some elements count: in the same proportions, and together 1.

        The consistency ratio stays that of all judgements. Weighed by themselves, some of the judgements that are
        consistent enough together may not be.
        """
        kept = [(name, weight) for name, weight in zip(self.names, self.weights, strict=True) if name in names]
        total = math.fsum(weight for _, weight in kept)
        return replace(
            self,
            names=tuple(name for name, _ in kept),
            weights=tuple(weight / total for _, weight in kept),
        )


def weigh(names: Sequence[str], judgements: Judgements) -> Weights:
    """The weights of elements that were compared in pairs.

    Args:
        names: the elements, at most 15.
        judgements: one for each pair, on Saaty's scale from 1/9 to 9.

    Raises:
        JudgementsInvalid: with every problem: a pair that is missing, a value off the scale, two that contradict each
            other, a name that is not among `names`; or that all together are inconsistent, with the worst one.
    """
    matrix = _matrix(names, judgements)
    weights, lambda_max = _principal_eigenvector(matrix)
    count = len(names)
    ratio = 0.0
    if count > 2:  # two elements cannot contradict each other
        ratio = max(lambda_max - count, 0.0) / (count - 1) / RANDOM_INDEX[count - 1]
    if ratio > HIGHEST_CONSISTENCY_RATIO:
        raise JudgementsInvalid([_inconsistency(names, matrix, weights, ratio)], consistency_ratio=ratio)
    return Weights(tuple(names), tuple(weights), lambda_max, ratio)


def _matrix(names: Sequence[str], judgements: Judgements) -> _Matrix:
    problems: list[str] = []
    if not 1 <= len(names) <= MOST_ELEMENTS:
        problems.append(f"there are {len(names)} elements; 1 to {MOST_ELEMENTS} can be compared")
    problems += [f"{name!r} is there twice" for name in sorted({name for name in names if names.count(name) > 1})]
    for pair, value in judgements.items():
        problems += _problems_of(pair, value, names)
    if not problems:
        for one, other in combinations(names, 2):
            forth, back = judgements.get((one, other)), judgements.get((other, one))
            if forth is None and back is None:
                problems.append(f"{one!r} and {other!r} are not compared")
            elif forth is not None and back is not None and abs(forth * back - 1) > _ROUNDING * max(forth, back, 1):
                problems.append(
                    f"{one!r} to {other!r} is {forth:g} and the other way {back:g}; give one of them, or {1 / forth:g}"
                )
    if problems:
        raise JudgementsInvalid(problems)
    return [[_entry(row, column, judgements) for column in names] for row in names]


def _problems_of(pair: tuple[str, str], value: float, names: Sequence[str]) -> list[str]:
    one, other = pair
    unknown = [name for name in pair if name not in names]
    if unknown:
        return [f"{name!r} is not among {', '.join(map(repr, names))}" for name in unknown]
    what = f"{one!r} to {other!r}"
    if not math.isfinite(value) or value <= 0:
        return [f"{what} is {value:g}; a judgement is a number from 1/9 to 9"]
    if one == other:
        return [] if value == 1 else [f"{what} is {value:g}; anything is as important as itself, 1"]
    if not 1 / LARGEST_JUDGEMENT - _ROUNDING <= value <= LARGEST_JUDGEMENT + _ROUNDING:
        return [f"{what} is {value:g}; Saaty's scale goes from 1/9 to 9"]
    return []


def _entry(row: str, column: str, judgements: Judgements) -> float:
    if row == column:
        return 1.0
    value = judgements.get((row, column))
    return 1 / judgements[column, row] if value is None else value


def _principal_eigenvector(matrix: _Matrix) -> tuple[list[float], float]:
    """By power iteration, which converges for every positive matrix (Perron and Frobenius)."""
    count = len(matrix)
    vector, eigenvalue = [1 / count] * count, float(count)
    for _ in range(_MOST_STEPS):
        image = [math.fsum(a * x for a, x in zip(row, vector, strict=True)) for row in matrix]
        eigenvalue = math.fsum(image)
        image = [value / eigenvalue for value in image]
        change = max(abs(a - b) for a, b in zip(image, vector, strict=True))
        vector = image
        if change < _PRECISION:
            break
    return vector, eigenvalue


def _inconsistency(names: Sequence[str], matrix: _Matrix, weights: Sequence[float], ratio: float) -> str:
    def disagreement(pair: tuple[int, int]) -> float:
        row, column = pair
        return abs(math.log(matrix[row][column] * weights[column] / weights[row]))

    row, column = max(combinations(range(len(names)), 2), key=disagreement)
    if matrix[row][column] < 1:  # said the way in which it is a number above 1
        row, column = column, row
    return (
        f"the judgements contradict each other (consistency ratio {ratio:.3f}, at most {HIGHEST_CONSISTENCY_RATIO} is "
        f"taken): {names[row]!r} to {names[column]!r} is {matrix[row][column]:g}, and the others say "
        f"{weights[row] / weights[column]:.2g}"
    )
