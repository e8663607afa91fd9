"""The facts of a carried run as the server's journal has them, which do not grow with the rounds of a `repeat`. Pure.

Of rounds that are over these stay:

    the last tasks            as many as people are shown
    the last facts            since the first of these tasks, but no more than so many: rounds may have no task
    the newest round          of each step, which proves that all before it are over: a repetition has one round at a
                              time. An adoption goes by that
    the newest that was done  of each task: its results may be read, and `after` goes by it
    who stands in for whom    and which robots have come back

What would be forgotten is not taken once more, either: a server that is started again fetches from the beginning what
bridges have.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from ua_fleet.scenario.facts import (
    Fact,
    IterationStarted,
    Replaced,
    RobotReturned,
    StepEnded,
    StepState,
    TaskAnswered,
    TaskAssigned,
    TaskOver,
    Then,
    encode_fact,
)

__all__ = ["FORGOTTEN_EACH", "KEPT_FACTS", "KEPT_TASKS", "FollowedFacts"]

KEPT_TASKS: Final = 500
"""The last ones. A run shows as many."""
KEPT_FACTS: Final = 5000
"""The last ones, where they are fewer than those since the first of these tasks: a round may have no task at all."""
FORGOTTEN_EACH: Final = 500
"""After so many new facts those that are not needed are forgotten."""

_Place = tuple[str, tuple[int, ...]]
"""A step, and the rounds of the repetitions around it."""


class FollowedFacts:
    """Those of one run."""

    def __init__(self, facts: Iterable[Fact] = (), *, kept_tasks: int = KEPT_TASKS) -> None:
        """Begin with what the journal has."""
        self._kept_tasks = kept_tasks
        self._known = {encode_fact(fact): fact for fact in facts}
        self._newest: dict[str, tuple[int, ...]] = {}
        """The newest round of each step."""
        self._since: float | None = None
        """What has happened since then stays, by the wall clock; None: all does."""
        self._kept_steps: set[str] = set()
        """Steps that stay besides, in these rounds."""
        self._returned: dict[tuple[str, str], float] = {}
        """When each robot has come back last, by the capacity for which it has."""
        self._new = 0
        for fact in self._known.values():
            self._look_at(fact)
        self._look_back()

    def __len__(self) -> int:
        return len(self._known)

    def take(self, fact: Fact) -> bool:
        """Know a fact; whether it is new, and to be written down."""
        line = encode_fact(fact)
        if line in self._known or self._is_past(fact):
            return False
        self._known[line] = fact
        self._look_at(fact)
        self._new += 1
        return True

    def forget(self) -> list[str]:
        """The lines of the facts that are needed no more, each once; none before enough new ones have come."""
        if self._new < FORGOTTEN_EACH:
            return []
        self._new = 0
        self._look_back()
        lines = [line for line, fact in self._known.items() if self._is_past(fact)]
        for line in lines:
            del self._known[line]
        return lines

    def _look_at(self, fact: Fact) -> None:
        if (place := _place(fact)) is not None:
            step, rounds = place
            self._newest[step] = max(rounds, self._newest.get(step, rounds))

    def _is_past(self, fact: Fact) -> bool:
        if self._since is None or fact.at >= self._since:
            return False
        if isinstance(fact, RobotReturned):
            return fact.at < self._returned.get((fact.robot, fact.capacity), fact.at)
        if (place := _place(fact)) is None:
            return False
        step, rounds = place
        return rounds < self._newest.get(step, rounds) and _step(fact) not in self._kept_steps

    def _look_back(self) -> None:
        """See what has to stay."""
        facts = sorted(self._known.values(), key=lambda fact: fact.at)
        shown: dict[str, None] = {}
        self._since = facts[-KEPT_FACTS].at if len(facts) >= KEPT_FACTS else None
        for fact in reversed(facts):
            if isinstance(fact, TaskAssigned):
                shown[fact.step] = None
                if len(shown) >= self._kept_tasks:
                    self._since = fact.at if self._since is None else max(fact.at, self._since)
                    break
        done: dict[str, tuple[tuple[int, ...], str]] = {}
        for fact in facts:
            if _is_done(fact) and (place := _place(fact)) is not None:
                step, rounds = place
                done[step] = max((rounds, _step(fact)), done.get(step, (rounds, _step(fact))))
        self._returned = {(fact.robot, fact.capacity): fact.at for fact in facts if isinstance(fact, RobotReturned)}
        self._kept_steps = {*shown, *[step for _, step in done.values()], *_standing_in(facts)}


def _step(fact: Fact) -> str:
    """The key of a fact's step, with the rounds; empty where it is about none."""
    step: str = getattr(fact, "step", "")
    return step


def _place(fact: Fact) -> _Place | None:
    """The step and the round of a fact; None where it is about none, or not within a repetition."""
    step, *numbers = _step(fact).split("@")
    rounds = tuple([int(number) for number in numbers if number.isascii() and number.isdecimal()])
    if isinstance(fact, IterationStarted):
        return f"{step} decides", (*rounds, fact.number)
    return (step, rounds) if rounds else None


def _is_done(fact: Fact) -> bool:
    match fact:
        case TaskOver() | TaskAnswered():
            return fact.then is Then.DONE
        case StepEnded():
            return fact.state is StepState.DONE
        case _:
            return False


def _standing_in(facts: Iterable[Fact]) -> set[str]:
    """The steps at which robots were chosen that still stand in for others, or were repaired last."""
    chosen: dict[tuple[str, str], str] = {}
    repaired: dict[tuple[str, tuple[str, ...]], str] = {}
    for fact in facts:
        if isinstance(fact, RobotReturned):
            chosen.pop((fact.robot, fact.capacity), None)
        elif isinstance(fact, Replaced):
            capacities = tuple(fact.capacities) or ("",)
            if fact.failed == fact.robot:
                repaired[fact.failed, capacities] = fact.step
                for capacity in ("", *capacities):
                    chosen.pop((fact.failed, capacity), None)
            elif fact.lasting and fact.failed:
                chosen |= {(fact.failed, capacity): fact.step for capacity in capacities}
    return {*chosen.values(), *repaired.values()}
