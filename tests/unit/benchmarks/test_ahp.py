"""The benchmark `ahp`: both sides come to the same, which it checks before it measures."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks import ahp
from ua_fleet.resilience import Candidate, Ranking, Synthesis, rank, weigh


@pytest.mark.parametrize("count", [2, 10, 100])
def test_both_come_to_the_same(count: int) -> None:
    ahp.check(ahp.fleet(count))


@pytest.mark.parametrize(("synthesis", "equal"), [(Synthesis.DISTRIBUTIVE, True), (Synthesis.IDEAL, False)])
def test_another_ranking_is_found(synthesis: Synthesis, equal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    weights = weigh(ahp.NAMES, ahp.JUDGEMENTS)
    if equal:
        weights = replace(weights, weights=(0.2,) * 5)

    def ours(candidates: list[Candidate]) -> Ranking:
        return rank(ahp.CRITERIA, weights, candidates, synthesis=synthesis)

    monkeypatch.setattr(ahp, "ours", ours)
    with pytest.raises(AssertionError):
        ahp.check(ahp.fleet(10))
