"""Which steps wait for, or read, what a task of another branch of a `parallel` does: `after`, and results."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from ua_fleet.carrying.steps import inner_steps, names_at, walked
from ua_fleet.scenario.model import Parallel, Scenario, Step, Task

__all__ = ["Crossing", "crossings_of", "keys_in"]


class Crossing(NamedTuple):
    """A step that hears of a task of another branch."""

    task: str
    source: str
    """The key of that task."""
    reader: str
    """The key of the step."""
    results: frozenset[str]
    """What the step reads of it, `task.result`."""


def keys_in(step: Step) -> frozenset[str]:
    """The keys of a step and all within it."""
    return frozenset([each.key for each in walked(step)])


def crossings_of(scenario: Scenario) -> list[Crossing]:
    """All of them, in the order of their steps."""
    places = dict(_places(scenario.body, ()))
    tasks = {task.name: task.key for task in scenario.tasks()}
    found: list[Crossing] = []
    for step in scenario.steps():
        heard: dict[str, set[str]] = {name: set() for name in (step.after if isinstance(step, Task) else ())}
        for name in names_at(step):
            heard.setdefault(name.partition(".")[0], set()).add(name)
        for task in sorted(heard):
            source = tasks.get(task)
            if source is not None and _are_beside(places[source], places[step.key]):
                found.append(Crossing(task, source, step.key, frozenset(heard[task])))
    return found


_Around = tuple[tuple[str, int, bool], ...]
"""The steps around a step: their keys, which part of each it is in, and whether parts are side by side."""


def _places(step: Step, around: _Around) -> Iterator[tuple[str, _Around]]:
    yield step.key, around
    for number, part in enumerate(inner_steps(step)):
        yield from _places(part, (*around, (step.key, number, isinstance(step, Parallel))))


def _are_beside(one: _Around, other: _Around) -> bool:
    for (key, number, is_parallel), (other_key, other_number, _) in zip(one, other, strict=False):
        if key != other_key:
            return False
        if number != other_number:
            return is_parallel
    return False
