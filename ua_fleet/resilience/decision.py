"""One open choice of a replacement: ranked again whenever something changes, until somebody or time ends it.

    open --confirm, limit with `best`, mode Automatic--> chosen     --replacement fails as well--> a new Decision
    open --limit with `abort`, no candidate left, mode Abort--> aborted

In mode Operator a ranking without candidates stays open until the limit, since a robot may become free or be repaired.
In mode Automatic it stays open while a robot may still be heard that was silent for a short time.

Where nobody knows what the first robot is at, a second one beside it is dangerous: then nothing is chosen at once, in
whatever mode, and the limit chooses only with the consent that is written as `best`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from ua_fleet.errors import NoCandidate
from ua_fleet.resilience.ranking import Ranking

__all__ = [
    "Aborted",
    "Confirmation",
    "Decision",
    "DecisionEvent",
    "DecisionMode",
    "OnLimit",
    "RankingChanged",
    "ReplacementChosen",
]


class DecisionMode(StrEnum):
    """Who chooses."""

    OPERATOR = "operator"
    AUTOMATIC = "automatic"
    ABORT = "abort"


class OnLimit(StrEnum):
    """What happens when no operator has chosen in time."""

    BEST_IF_KNOWN = "best_if_known"
    """The best candidate of then is taken, without one the task is aborted; and also where nobody knows what the first
    robot is at."""
    BEST = "best"
    """The best candidate of then is taken in any case: it is consented to that two robots may be at one task."""
    ABORT = "abort"


@dataclass(frozen=True, slots=True)
class RankingChanged:
    """The order, a score or a reason is not what it was."""

    decision_id: str
    ranking: Ranking


@dataclass(frozen=True, slots=True)
class ReplacementChosen:
    """The task goes to another robot."""

    decision_id: str
    robot: str
    by: str
    """The operator's name, or `automatic`, or `limit`; `back`: the robot that could not begin, and now can."""
    ranking: Ranking


@dataclass(frozen=True, slots=True)
class Aborted:
    """Nobody takes the task over."""

    decision_id: str
    reason: str


DecisionEvent = RankingChanged | ReplacementChosen | Aborted


class Confirmation(StrEnum):
    """What became of an operator's confirmation."""

    TAKEN = "taken"
    REPEATED = "repeated"
    """The same robot was chosen before: nothing happens a second time."""


class Decision:
    """A choice that is to be made for one task of one failed robot."""

    def __init__(
        self,
        decision_id: str,
        mode: DecisionMode,
        ranking: Ranking,
        *,
        limit_s: float,
        on_limit: OnLimit,
        now: float,
        is_unknown: bool = False,
        hope_until: float | None = None,
        not_before: float | None = None,
    ) -> None:
        """Open a decision; `begin` says what follows at once.

        Args:
            decision_id: name of the decision.
            mode: who chooses.
            ranking: of the candidates at the fault.
            limit_s: how long an operator may think.
            on_limit: what happens then.
            now: the time.
            is_unknown: whether nobody knows what the first robot is at.
            hope_until: so long a candidate may still be heard.
            not_before: so long the first robot may still say that it has done it; only a person chooses meanwhile.
        """
        self._now, self._not_before = now, -math.inf if not_before is None else not_before
        self.id, self.mode, self.ranking = decision_id, mode, ranking
        self._limit_at, self._on_limit, self._is_unknown = now + limit_s, on_limit, is_unknown
        self._hope_until = -math.inf if hope_until is None else hope_until
        self.outcome: ReplacementChosen | Aborted | None = None

    def begin(self) -> list[DecisionEvent]:
        """What is known at the start: the ranking, and in the modes without an operator the choice."""
        events: list[DecisionEvent] = [RankingChanged(self.id, self.ranking)]
        if self._is_unknown:
            return events
        if self.mode is DecisionMode.ABORT:
            events.append(self._abort("the mode is Abort"))
        elif self._now < self._not_before:
            pass
        elif self.mode is DecisionMode.AUTOMATIC and (self.ranking.best is not None or self._hope_until == -math.inf):
            events.append(self._best("automatic"))
        return events

    def rank_again(self, ranking: Ranking, hope_until: float | None = None) -> list[DecisionEvent]:
        """Take a new ranking; says so where it differs from the one before. Nothing changes what is decided."""
        self._hope_until = -math.inf if hope_until is None else hope_until
        if self.outcome is not None or ranking == self.ranking:
            return []
        self.ranking = ranking
        return [RankingChanged(self.id, ranking)]

    def confirm(self, robot: str, by: str) -> tuple[Confirmation, list[DecisionEvent]]:
        """Choose a robot for an operator. Of two who choose at once the first decides.

        Raises:
            NoCandidate: the robot is not in the ranking, or another one was chosen before, or all was given up.
        """
        done = self.outcome
        if isinstance(done, Aborted):
            raise NoCandidate(f"{self.id} was given up: {done.reason}")
        if done is not None:
            if done.robot == robot:
                return Confirmation.REPEATED, []
            raise NoCandidate(f"{self.id}: {done.by} has chosen {done.robot} before")
        if self.ranking.without(robot):
            reason = next((left.reason for left in self.ranking.excluded if left.robot == robot), "no such candidate")
            raise NoCandidate(f"{self.id}: {robot} cannot take over: {reason}")
        return Confirmation.TAKEN, [self._choose(robot, by)]

    def take_back(self, robot: str) -> list[DecisionEvent]:
        """The robot that could not begin can do it now."""
        return [self._choose(robot, "back")] if self.outcome is None else []

    def give_up(self, reason: str) -> list[DecisionEvent]:
        """End it without a choice: nobody needs one any more."""
        return [self._abort(reason)] if self.outcome is None else []

    def poll(self, now: float) -> list[DecisionEvent]:
        """End the decision when its limit is over; in mode Automatic as soon as there is a candidate, or no hope."""
        if self.outcome is not None:
            return []
        if self.is_by_itself:
            is_known = self.ranking.best is not None or now >= self._hope_until
            return [self._best("automatic")] if is_known and now >= self._not_before else []
        if now < self._limit_at:
            return []
        if self._on_limit is OnLimit.ABORT:
            return [self._abort("no operator chose in time")]
        if self._is_unknown and self._on_limit is not OnLimit.BEST:
            return [self._abort("nobody consented in time to a second robot beside the first")]
        return [self._best("limit")]

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        if self.outcome is not None:
            return None
        if not self.is_by_itself:
            return self._limit_at
        return self._not_before if self.ranking.best is not None else max(self._hope_until, self._not_before)

    @property
    def is_by_itself(self) -> bool:
        """Whether the best candidate is taken as soon as there is one."""
        return self.mode is DecisionMode.AUTOMATIC and not self._is_unknown

    def _best(self, by: str) -> DecisionEvent:
        robot = self.ranking.best
        return self._abort("no robot is left that can take over") if robot is None else self._choose(robot, by)

    def _choose(self, robot: str, by: str) -> ReplacementChosen:
        chosen = self.outcome = ReplacementChosen(self.id, robot, by, self.ranking)
        return chosen

    def _abort(self, reason: str) -> Aborted:
        aborted = self.outcome = Aborted(self.id, reason)
        return aborted
