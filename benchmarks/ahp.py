"""Ranking candidates beside ahpy: from judgements and raw values to the order, weights and consistency ratio.

What both can do: five criteria compared in pairs, raw values of benefits shared out (v / sum(v)), the distributive
synthesis. ahpy has no costs, so it is given their reciprocals; the time to make these is not counted. Our ranking
holds each raw value and score beside the sum, for the explanation; ahpy's objects hold the same. Before anything is
timed both must come to the same: weights, consistency ratio and each candidate's score to four digits, and one order.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from random import Random
from typing import Any, Protocol, cast

from benchmarks.harness import Figure, at_least, interleaved
from ua_fleet.resilience import Candidate, Criterion, CriterionKind, Ranking, rank, weigh

compare: Any = import_module("ahpy").Compare
"""Without type hints."""
REFERENCE = "ahpy"
GOAL = 1.0
CANDIDATES = (10, 100, 1000)
PRECISION = 12
"""Decimal places that ahpy rounds to; its default of 4 makes many of 1,000 candidates equal."""
JUDGEMENTS = {
    ("battery", "distance"): 2.0,
    ("battery", "availability"): 3.0,
    ("battery", "payload"): 4.0,
    ("battery", "noise"): 7.0,
    ("distance", "availability"): 2.0,
    ("distance", "payload"): 3.0,
    ("distance", "noise"): 5.0,
    ("availability", "payload"): 2.0,
    ("availability", "noise"): 4.0,
    ("payload", "noise"): 2.0,
}
CRITERIA = (
    Criterion("battery", CriterionKind.BENEFIT, (0, 100)),
    Criterion("distance", CriterionKind.COST, (0, 50)),
    Criterion("availability", CriterionKind.BENEFIT, (0, 100)),
    Criterion("payload", CriterionKind.BENEFIT, (0, 20)),
    Criterion("noise", CriterionKind.COST, (0, 90)),
)
NAMES = tuple(criterion.name for criterion in CRITERIA)
SECONDS = 0.05
"""About how long one measure of a round takes."""


class Compared(Protocol):
    """What ahpy's Compare has, as far as it is used here."""

    local_weights: dict[str, float]
    target_weights: dict[str, float]
    consistency_ratio: float

    def add_children(self, children: list[Compared]) -> None: ...


def fleet(count: int) -> list[Candidate]:
    """Candidates with random raw values, none below what a cost is rounded up to."""
    random = Random(count)
    return [
        Candidate(
            f"r{number:04}",
            {criterion.name: random.uniform(criterion.range[1] * 0.02, criterion.range[1]) for criterion in CRITERIA},
        )
        for number in range(count)
    ]


def ours(candidates: list[Candidate]) -> Ranking:
    return rank(CRITERIA, weigh(NAMES, JUDGEMENTS), candidates)


def benefits(candidates: list[Candidate]) -> dict[str, dict[str, float]]:
    """The raw values as ahpy takes them."""
    return {
        criterion.name: {
            one.robot: one.values[criterion.name] ** (1 if criterion.kind is CriterionKind.BENEFIT else -1)
            for one in candidates
        }
        for criterion in CRITERIA
    }


def theirs(values: dict[str, dict[str, float]]) -> Compared:
    parent = cast("Compared", compare("all", JUDGEMENTS, precision=PRECISION, random_index="saaty"))
    parent.add_children([compare(name, column, precision=PRECISION) for name, column in values.items()])
    return parent


def check(candidates: list[Candidate]) -> None:
    """Both come to the same."""
    mine, other = ours(candidates), theirs(benefits(candidates))
    assert mine.excluded == ()
    assert abs(mine.weights.consistency_ratio - other.consistency_ratio) < 1e-4
    for name in NAMES:
        assert abs(mine.weights.of(name) - other.local_weights[name]) < 1e-6, name
    assert [place.robot for place in mine.ranked] == list(other.target_weights)
    for place in mine.ranked:
        assert abs(place.score / other.target_weights[place.robot] - 1) < 1e-4, place.robot


def per_call(function: Callable[[Any], object], argument: Any) -> float:
    """Seconds of one call, over a fixed time."""
    repeats, started = 0, time.perf_counter()
    while (taken := time.perf_counter() - started) < SECONDS:
        function(argument)
        repeats += 1
    return taken / repeats


def figures(rounds: int) -> list[Figure]:
    rows: list[Figure] = []
    for count in CANDIDATES:
        candidates = fleet(count)
        values = benefits(candidates)
        check(candidates)
        mine, other = interleaved(rounds, [partial(per_call, ours, candidates), partial(per_call, theirs, values)])
        rows.append(
            at_least(
                f"judgements and raw values to a ranking, {count:,} candidates",
                mine * 1e6,
                "us",
                reference=REFERENCE,
                reference_value=other * 1e6,
                goal=GOAL,
            )
        )
    return rows
