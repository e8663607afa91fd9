"""Rounds of repetitions in the keys of steps, and as people name them: `task@41`, or `task@4@2` within two. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from ua_fleet.carrying.steps import walked
from ua_fleet.names import closest, listed
from ua_fleet.scenario.facts import Fact, IterationStarted
from ua_fleet.scenario.model import BranchPoint, Repeat, Step, Task

__all__ = [
    "NO_ROUND",
    "depth_of",
    "example_of",
    "named_rounds",
    "repeats_around",
    "rounds_begun",
    "rounds_of",
    "times_of",
    "why_unclear",
]

NO_ROUND: Final = "none"
"""What a person says with a task, as `task@none`, of which no round was done that was not heard of."""
_MOST_ROUND: Final = 0xFFFF_FFFF
"""A token says the number of a round with 32 bits."""
_MOST_DIGITS: Final = 10


def repeats_around(key: str) -> list[str]:
    """The keys of the repetitions around a step, the outer ones first; its own key has no numbers."""
    parts = key.split(".")
    return [".".join(parts[:at]) for at, part in enumerate(parts) if part == "repeat"]


def depth_of(key: str) -> int:
    """How many repetitions are around a step."""
    return key.split(".").count("repeat")


def rounds_of(step: str) -> tuple[int, ...]:
    """The numbers of the repetitions in which a step is: as far as they are numbers."""
    return tuple([int(number) for number in step.split("@")[1:] if _is_number(number)])


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) <= _MOST_DIGITS and int(text) <= _MOST_ROUND


def named_rounds(key: str, said: str) -> tuple[int, ...] | None:
    """The rounds that a person has named with a task; None where these are not one number for each repetition.

    Args:
        key: of the task, without numbers.
        said: what came behind the first `@`.
    """
    numbers = said.split("@")
    if not all(map(_is_number, numbers)) or len(numbers) != depth_of(key):
        return None
    return tuple(map(int, numbers))


def example_of(task: Task) -> str:
    """How the last round of a task is named, with a word in place of each number."""
    depth = depth_of(task.key)
    inner = ["OUTER", *[f"ROUND{number}" for number in range(2, depth)], "INNER"]
    return "@".join((task.name or task.key, *(["ROUND"] if depth == 1 else inner)))


def times_of(steps: Iterable[Step]) -> dict[str, int]:
    """How many rounds repetitions have at most, by their keys; of those that say so."""
    every = [each for step in steps for each in walked(step)]
    return {
        one.key: one.times
        for one in every
        if (isinstance(one, Repeat) or (isinstance(one, BranchPoint) and one.is_loop)) and one.times is not None
    }


def rounds_begun(facts: Iterable[Fact]) -> dict[str, tuple[int, ...]]:
    """The newest round of each repetition of which facts say that it was begun, by its key."""
    newest: dict[str, tuple[int, ...]] = {}
    for fact in facts:
        if isinstance(fact, IterationStarted):
            key, rounds = fact.step.partition("@")[0], (*rounds_of(fact.step), fact.number)
            newest[key] = max(rounds, newest.get(key, rounds))
    return newest


def why_unclear(
    name: str, tasks: Iterable[Task], times: Mapping[str, int], begun: Mapping[str, tuple[int, ...]]
) -> str:
    """Why what a person says with `--done` cannot be taken; empty where it can.

    Args:
        name: a task, or its key, with what the person says of its round.
        tasks: those that may be named.
        times: see `times_of`.
        begun: the newest round of repetitions, by their keys; of those of which all is known. Empty: none was begun.
    """
    named, at, said = name.partition("@")
    shown, tasks = repr(name[:80]), list(tasks)
    task = next((one for one in tasks if named in (one.name, one.key)), None)
    if task is None:
        names = [one.name for one in tasks]
        return (
            f"{shown}: the bridge that is off does no such task; {closest(named, names) or f'it does {listed(names)}'}"
        )
    if not at:
        return ""
    if not depth_of(task.key):
        return f"{shown}: the task is in no repeat; name it without a round: --done {named}"
    if said == NO_ROUND:
        return ""
    rounds = named_rounds(task.key, said)
    if rounds is None:
        return (
            f"{shown} does not say a round; write --done {example_of(task)} with the round that was done last, a"
            f" number from 0, or --done {named}@{NO_ROUND} where none more was done"
        )
    for repeat, number in zip(repeats_around(task.key), rounds, strict=True):
        if number >= (most := times.get(repeat, number + 1)):
            return f"{shown}: there is no round {number}; the last one of that repeat is {most - 1}, counted from 0"
    for depth, repeat in enumerate(repeats_around(task.key), 1):
        if rounds[:depth] > (newest := begun.get(repeat, rounds)):
            last = f"the last one that has is {'@'.join(map(str, newest))}, counted from 0" if newest else "none has"
            return f"{shown}: that round of the repeat has not begun; {last}, as the bridge says that begins them"
    return ""
