"""Which results each token has to hold: those that may be there already, and that are read from there on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ua_fleet.carrying.plan import Segment
from ua_fleet.carrying.steps import names_in, tasks_in
from ua_fleet.scenario.model import Task

__all__ = ["results_needed"]


def results_needed(
    segments: Sequence[Segment], tasks: Mapping[str, Task], branches: Mapping[int, Sequence[frozenset[str]]]
) -> list[list[tuple[str, ...]]]:
    """The names for each slot of each segment; of mailboxes, which have their own, none.

    Args:
        segments: of the plan, with their edges.
        tasks: of the scenario, by their names.
        branches: the tasks of each branch that a join, by its number, joins. A result of one of them is held by the
            token of its branch, since others may know an earlier one.
    """
    done = [{task.name for step in segment.steps for task in tasks_in(step)} for segment in segments]
    before = _done_before(segments, done)
    read = _read_from(segments, tasks, branches)
    needs: list[list[tuple[str, ...]]] = []
    for number, segment in enumerate(segments):
        there = sorted(name for name in read[number] if _owner(name) in before[number])
        joined = branches.get(number, ())
        slots = 0 if segment.tells else segment.slots
        needs.append([tuple([name for name in there if _slot_of(name, joined) == slot]) for slot in range(slots)])
    return needs


def _owner(name: str) -> str:
    """The task of a result."""
    return name.partition(".")[0]


def _slot_of(name: str, joined: Sequence[frozenset[str]]) -> int:
    """The slot of a join whose token holds a result; what was there before the branches comes by the first one."""
    return next((slot for slot, tasks in enumerate(joined) if _owner(name) in tasks), 0)


def _done_before(segments: Sequence[Segment], done: Sequence[set[str]]) -> list[set[str]]:
    """The tasks that may have been done when each segment begins, in a round before also those behind it."""
    before: list[set[str]] = [set() for _ in segments]
    left = list(range(len(segments)))
    while left:
        number = left.pop()
        known = before[number] | done[number]
        for edge in (*segments[number].then, *segments[number].otherwise):
            if not known <= before[edge.segment]:
                before[edge.segment] |= known
                left.append(edge.segment)
    return before


def _read_from(
    segments: Sequence[Segment], tasks: Mapping[str, Task], branches: Mapping[int, Sequence[frozenset[str]]]
) -> list[set[str]]:
    """The results that each segment, or one behind it, reads before they are given anew."""
    reads = [_read_in(segment, tasks) for segment in segments]
    given = [{step.name for step in segment.steps if isinstance(step, Task)} for segment in segments]
    behind: list[list[tuple[int, int]]] = [[] for _ in segments]
    for number, segment in enumerate(segments):
        for edge in (*segment.then, *segment.otherwise):
            behind[edge.segment].append((number, edge.slot))
    left = list(range(len(segments)))
    while left:
        number = left.pop()
        joined = branches.get(number, ())
        for one, slot in behind[number]:
            held = {name for name in reads[number] if _slot_of(name, joined) == slot}
            passed = {name for name in held if _owner(name) not in given[one]}
            if not passed <= reads[one]:
                reads[one] |= passed
                left.append(one)
    return reads


def _read_in(segment: Segment, tasks: Mapping[str, Task]) -> set[str]:
    """What is read in a segment of results that it does not give itself before."""
    given: set[str] = set()
    read: set[str] = set()
    for step in segment.steps:
        read |= {name for name in names_in(step) if _owner(name) in tasks and _owner(name) not in given}
        if isinstance(step, Task):
            given.add(step.name)
    return read
