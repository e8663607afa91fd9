"""Candidates in the order of their scores, with everything that led to them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from ua_fleet.resilience.ahp import Weights
from ua_fleet.resilience.criteria import Criterion

__all__ = ["Candidate", "Excluded", "Ranked", "Ranking", "Synthesis", "rank"]


class Synthesis(StrEnum):
    """How the scores of single criteria become one (T. L. Saaty and L. G. Vargas, 1993).

    `distributive` shares out each criterion's weight, so that a further candidate changes all shares. `ideal` gives the
    best candidate of each criterion all of its weight, so that a further candidate who is nowhere the best changes no
    order.
    """

    DISTRIBUTIVE = "distributive"
    IDEAL = "ideal"


@dataclass(frozen=True, slots=True)
class Candidate:
    """A robot with the needed capacities, and its raw value for each criterion."""

    robot: str
    values: Mapping[str, float]
    unknown: Mapping[str, str] = field(default_factory=dict[str, str])
    """Criteria whose value is not known, with the reason."""


@dataclass(frozen=True, slots=True)
class Excluded:
    """A robot that was not a candidate, and why."""

    robot: str
    reason: str


@dataclass(frozen=True, slots=True)
class Ranked:
    """One candidate's place. The criteria are in the order of the ranking's weights."""

    robot: str
    score: float
    """The scores of all candidates together are 1."""
    raw: tuple[float, ...]
    scores: tuple[float, ...]
    """What each raw value is worth, before its weight."""


@dataclass(frozen=True, slots=True)
class Ranking:
    """The candidates, the best first, and why."""

    weights: Weights
    synthesis: Synthesis
    ranked: tuple[Ranked, ...]
    excluded: tuple[Excluded, ...]

    @property
    def best(self) -> str | None:
        """The robot of the highest score, or None without a candidate."""
        return self.ranked[0].robot if self.ranked else None

    def without(self, robot: str) -> bool:
        """Whether a robot cannot be chosen."""
        return all(place.robot != robot for place in self.ranked)


def rank(
    criteria: Sequence[Criterion],
    weights: Weights,
    candidates: Sequence[Candidate],
    *,
    excluded: Sequence[Excluded] = (),
    synthesis: Synthesis = Synthesis.DISTRIBUTIVE,
) -> Ranking:
    """Rank candidates. Of equal scores the name that comes first in the alphabet goes first.

    Args:
        criteria: in any order; those that `weights` names.
        weights: of the criteria.
        candidates: robots that could take over. One without a usable value for a criterion is excluded, with the
            reason.
        excluded: robots that were left out before, for the explanation.
        synthesis: how single scores become one.
    """
    by_name = {criterion.name: criterion for criterion in criteria}
    ordered = [by_name[name] for name in weights.names]
    taken: list[Candidate] = []
    left_out = list(excluded)
    for candidate in candidates:
        objections = [text for criterion in ordered if (text := _objection(criterion, candidate)) is not None]
        if objections:
            left_out.append(Excluded(candidate.robot, "; ".join(objections)))
        else:
            taken.append(candidate)
    columns = [_column(criterion, taken, synthesis) for criterion in ordered]
    totals = [
        math.fsum(weight * column[place] for weight, column in zip(weights.weights, columns, strict=True))
        for place in range(len(taken))
    ]
    whole = math.fsum(totals) or 1.0
    ranked = [
        Ranked(
            candidate.robot,
            totals[place] / whole,
            tuple(candidate.values[criterion.name] for criterion in ordered),
            tuple(column[place] for column in columns),
        )
        for place, candidate in enumerate(taken)
    ]
    ranked.sort(key=lambda place: (-place.score, place.robot))
    return Ranking(weights, synthesis, tuple(ranked), tuple(left_out))


def _objection(criterion: Criterion, candidate: Candidate) -> str | None:
    reason = candidate.unknown.get(criterion.name)
    if reason is not None:
        return f"{criterion.name} is not known: {reason}"
    value = candidate.values.get(criterion.name)
    if value is None:
        return f"{criterion.name} is not known"
    return criterion.objection(value)


def _column(criterion: Criterion, candidates: Sequence[Candidate], synthesis: Synthesis) -> tuple[float, ...]:
    scores = criterion.scores([candidate.values[criterion.name] for candidate in candidates])
    if synthesis is Synthesis.DISTRIBUTIVE or not scores:
        return scores
    best = max(scores)
    return tuple(score / best for score in scores)
