"""Candidates in the order of their scores, with everything that led to them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from ua_fleet.resilience.ahp import Weights
from ua_fleet.resilience.criteria import Criterion, Missing

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
    tasks_ahead: int = 0
    """Where no value of any candidate is known, who has less to do goes first."""


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
    """Its values as they count."""
    scores: tuple[float, ...]
    """What each raw value is worth, before its weight."""
    missing: tuple[str, ...]
    """For each raw value: empty, or why it is not known, and what counts in its place."""


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

    A candidate without a usable value counts as its criterion says. One that is alone needs no values at all. Where no
    value of any candidate is known, or no criterion counts, who has less to do goes first.

    Args:
        criteria: in any order; those that `weights` names.
        weights: of the criteria.
        candidates: robots that could take over.
        excluded: robots that were left out before, for the explanation.
        synthesis: how single scores become one.
    """
    by_name = {criterion.name: criterion for criterion in criteria}
    ordered = [by_name[name] for name in weights.names]
    taken, left_out = _parted(ordered, candidates)
    columns = [_Column.of(criterion, taken, synthesis) for criterion in ordered]
    totals = [
        math.fsum(weight * column.scores[place] for weight, column in zip(weights.weights, columns, strict=True))
        if columns
        else 1.0
        for place in range(len(taken))
    ]
    whole = math.fsum(totals) or 1.0
    ranked = [
        Ranked(
            candidate.robot,
            totals[place] / whole,
            tuple(column.raw[place] for column in columns),
            tuple(column.scores[place] for column in columns),
            tuple(column.missing[place] for column in columns),
        )
        for place, candidate in enumerate(taken)
    ]
    if all(text for column in columns for text in column.missing):
        ahead = {candidate.robot: candidate.tasks_ahead for candidate in taken}
        ranked.sort(key=lambda place: (ahead[place.robot], place.robot))
    else:
        ranked.sort(key=lambda place: (-place.score, place.robot))
    return Ranking(weights, synthesis, tuple(ranked), (*excluded, *left_out))


def _parted(criteria: Sequence[Criterion], candidates: Sequence[Candidate]) -> tuple[list[Candidate], list[Excluded]]:
    """Those that are compared, and those that give way to them since something is not known that must be."""
    needed = [criterion for criterion in criteria if criterion.missing is Missing.EXCLUDE]
    objections = [
        [text for criterion in needed if (text := _objection(criterion, candidate)) is not None]
        for candidate in candidates
    ]
    if all(objections):
        return list(candidates), []
    paired = list(zip(candidates, objections, strict=True))
    return (
        [candidate for candidate, against in paired if not against],
        [Excluded(candidate.robot, "; ".join(against)) for candidate, against in paired if against],
    )


def _objection(criterion: Criterion, candidate: Candidate) -> str | None:
    reason = candidate.unknown.get(criterion.name)
    if reason is not None:
        return f"{criterion.name} is not known: {reason}"
    value = candidate.values.get(criterion.name)
    if value is None:
        return f"{criterion.name} is not known"
    return criterion.objection(value)


@dataclass(frozen=True, slots=True)
class _Column:
    """One criterion of all candidates."""

    raw: tuple[float, ...]
    scores: tuple[float, ...]
    missing: tuple[str, ...]

    @classmethod
    def of(cls, criterion: Criterion, candidates: Sequence[Candidate], synthesis: Synthesis) -> _Column:
        objections = [_objection(criterion, candidate) for candidate in candidates]
        values = [
            candidate.values[criterion.name] if objection is None else None
            for candidate, objection in zip(candidates, objections, strict=True)
        ]
        stand_in = criterion.stand_in([value for value in values if value is not None])
        raw = tuple(stand_in if value is None else value for value in values)
        scores = criterion.scores(raw)
        if synthesis is Synthesis.IDEAL and scores:
            best = max(scores)
            scores = tuple(score / best for score in scores)
        how = "neutral" if criterion.missing is Missing.NEUTRAL else "the worst"
        counts = f"counts as {how}, {stand_in:.3g}{criterion.unit and ' ' + criterion.unit}"
        return cls(raw, scores, tuple("" if text is None else f"{text}; it {counts}" for text in objections))
