"""Repetitions within a segment: all their tasks are at one bridge, so that no token tells of their rounds. Pure.

What is known of them grows with the rounds, and a person may name a round of which nothing was heard. Their heir goes
on with the newest round, and needs of those before it what was done last of each task alone: its results may be read.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

from ua_fleet.carrying.named_rounds import depth_of, repeats_around, rounds_of
from ua_fleet.carrying.part import PartSegment
from ua_fleet.carrying.steps import tasks_in, walked
from ua_fleet.scenario.facts import Fact, IterationStarted, StepEnded, StepState, TaskAnswered, TaskOver, Then
from ua_fleet.scenario.model import Repeat, Task

__all__ = ["InnerRounds", "WholeRepeat", "whole_repeats"]


class WholeRepeat(NamedTuple):
    """A repetition that is within one segment."""

    key: str
    segment: int
    depth: int
    """How many numbers say its round: those of the repetitions around it, and its own."""
    tasks: Sequence[Task]
    heard: tuple[int, ...]
    """The newest of which facts tell; none where none does."""
    is_over: bool
    """Whether facts say that it begins no further round: never where another repetition may begin it anew."""


def whole_repeats(segment: PartSegment, facts: Sequence[Fact]) -> list[WholeRepeat]:
    """The repetitions within a segment that have tasks, the outer ones first; with what was heard of them."""
    return [
        _heard(WholeRepeat(step.key, segment.number, depth_of(step.key) + 1, tasks, (), is_over=False), facts)
        for step in walked(segment.body)
        if isinstance(step, Repeat) and (tasks := tasks_in(step))
    ]


def _heard(repeat: WholeRepeat, facts: Iterable[Fact]) -> WholeRepeat:
    newest, is_over = tuple[int, ...](), False
    for fact in facts:
        step: str = getattr(fact, "step", "")
        key, rounds = step.partition("@")[0], rounds_of(step)
        if key == repeat.key and isinstance(fact, IterationStarted):
            newest = max(newest, (*rounds, fact.number))
        elif repeat.key in repeats_around(key):
            newest = max(newest, rounds[: repeat.depth])
        elif step == repeat.key and isinstance(fact, StepEnded):
            is_over = repeat.depth == 1
    return repeat._replace(heard=newest, is_over=is_over)


class InnerRounds:
    """In which round the repetitions within one segment are, as its facts say and then a person."""

    def __init__(self, facts: Iterable[Fact], rounds: tuple[int, ...]) -> None:
        """Know what was heard of a segment in these rounds of the repetitions around it."""
        self._around = len(rounds)
        self._now: dict[str, int] = {}
        """The newest round of each repetition, by its key with the numbers of those around it."""
        for fact in facts:
            if isinstance(fact, IterationStarted):
                self._now[fact.step] = max(fact.number, self._now.get(fact.step, -1))

    def _positions(self, key: str, rounds: Sequence[int]) -> list[tuple[str, int]]:
        """Each repetition within the segment around a step, with the numbers of those around it, and its round."""
        found: list[tuple[str, int]] = []
        for depth, (repeat, number) in enumerate(zip(repeats_around(key), rounds, strict=False)):
            if depth >= self._around:
                found.append(("@".join((repeat, *map(str, rounds[:depth]))), number))
        return found

    def newest(self, key: str, rounds: tuple[int, ...]) -> tuple[int, ...]:
        """The rounds of a step that is named without those within the segment: the newest that are known."""
        for repeat in repeats_around(key)[len(rounds) :]:
            rounds = (*rounds, self._now.get("@".join((repeat, *map(str, rounds))), 0))
        return rounds

    def is_past(self, step: str) -> bool:
        """Whether a round of a step is over, since a newer one has begun."""
        key, rounds = step.partition("@")[0], rounds_of(step)
        return any(number < self._now.get(position, -1) for position, number in self._positions(key, rounds))

    def begin(self, step: str, at: float) -> list[Fact]:
        """Know that a step of which nobody has heard was done: what begins its rounds."""
        key, rounds = step.partition("@")[0], rounds_of(step)
        begun: list[Fact] = []
        for position, number in self._positions(key, rounds):
            if number > self._now.get(position, -1):
                self._now[position] = number
                begun.append(IterationStarted(at, position, number))
        return begun

    def needed(self, facts: Iterable[Fact], named: Collection[str]) -> list[Fact]:
        """Facts without those of rounds that are over, but for what was done last of each task.

        A result is of no account where the task was done in a newer round of which nothing was heard.

        Args:
            facts: of the segment.
            named: the steps that a person says were done, and of which nothing was heard.
        """
        known = list(facts)
        unheard = {step.partition("@")[0] for step in named}
        last: dict[str, tuple[tuple[int, ...], str]] = {}
        for fact in known:
            if _is_task_done(fact):
                step: str = getattr(fact, "step", "")
                key, rounds = step.partition("@")[0], rounds_of(step)
                last[key] = max((rounds, step), last.get(key, (rounds, step)))
        kept = {step for _, step in last.values()}
        found: list[Fact] = []
        for fact in known:
            step = getattr(fact, "step", "")
            is_over = isinstance(fact, IterationStarted) and fact.number < self._now[step]
            if not is_over and not self.is_past(step):
                found.append(fact)
            elif step in kept and not isinstance(fact, IterationStarted):
                is_stale = isinstance(fact, TaskOver) and step.partition("@")[0] in unheard
                found.append(replace(fact, results={}) if is_stale and isinstance(fact, TaskOver) else fact)
        return found


def _is_task_done(fact: Fact) -> bool:
    match fact:
        case TaskOver() | TaskAnswered():
            return fact.then is Then.DONE
        case StepEnded():
            return fact.state is StepState.DONE
        case _:
            return False
