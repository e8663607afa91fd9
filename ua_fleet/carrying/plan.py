"""A plan: a scenario as segments, what one bridge does without another one, and what comes after. See `splitting`.

    segment --ended--> a token to each of `then` --all slots filled--> the next segment
            --ended, decided that not--> a token to each of `otherwise` (of an `if` or a `repeat` that it ends with)
            --failed-> a token that says so to `fails`, the join around it; at the top to the last segment;
                       and to `lost`: what others wait for in the branch that has failed
    mailbox            a segment without steps, for what others read of a task of another branch; it leads nowhere

A segment is a list of steps of the scenario as they stand there, which the engine of scenarios runs in the bridge of
their robots. `parallel` over several bridges ends its segment, which has a token for each branch then; the join is a
segment of the same bridge, with a slot for each branch. `repeat` over several bridges has a segment that begins each
round, its head; segments within it are begun once in each round. So each slot gets one token in a round, and the end of
the last segment is the end of the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final, NamedTuple

from ua_fleet.carrying.steps import walked
from ua_fleet.carrying.token import WHOLE
from ua_fleet.errors import ConfigError
from ua_fleet.scenario import FleetView
from ua_fleet.scenario.model import End, Step

__all__ = ["Edge", "Hearing", "MailSlot", "Plan", "PlanView", "Segment", "Split", "missing_requestors"]

MOST_SEGMENTS: Final = 2000
MOST_SLOTS: Final = WHOLE
"""Branches of one `parallel`, since a slot is one byte."""


class MailSlot(IntEnum):
    """Slots of a mailbox."""

    DONE = 0
    """The task is done; with the results that are read."""
    LOST = 1
    """Its branch has failed: what was not done of it will not be."""


class Edge(NamedTuple):
    """Where a token goes."""

    segment: int
    slot: int
    is_next: bool = False
    """Whether it begins the next round of the repetition that the segment is the head of."""


class Hearing(NamedTuple):
    """A mailbox that a segment hears."""

    mailbox: int
    loops: int
    """Repetitions around both: what is said in other rounds of these is of no account."""


@dataclass(slots=True)
class Segment:
    """Steps that one bridge does, one after the other. It has the number that is its place in the plan."""

    space: int
    slots: int
    steps: list[Step] = field(default_factory=list[Step])
    then: list[Edge] = field(default_factory=list[Edge])
    """None: it is the last one, or a mailbox."""
    otherwise: list[Edge] = field(default_factory=list[Edge])
    """Where it ends with a decision: the way that is taken where that does not hold."""
    fails: Edge | None = None
    lost: list[Edge] = field(default_factory=list[Edge])
    needs: list[tuple[str, ...]] = field(default_factory=list[tuple[str, ...]])
    """Results of segments before, `task.result`, that are read here or later: what the token of each slot holds."""
    loops: tuple[int, ...] = ()
    """The heads of the repetitions around it, the outer ones first; a head is within its own."""
    hears: list[Hearing] = field(default_factory=list[Hearing])
    tells: str = ""
    """Of a mailbox: the task that it is about."""

    @property
    def roads(self) -> list[Edge]:
        """All places that a token of it may go to."""
        return [*self.then, *self.otherwise, *([] if self.fails is None else [self.fails]), *self.lost]


@dataclass(frozen=True, slots=True)
class Plan:
    """A scenario that can be carried. The first segment begins it, the last one ends it."""

    segments: tuple[Segment, ...]
    last: int
    lease_s: float
    """Reservations end by themselves when so long nothing has come of the run."""

    @property
    def spaces(self) -> tuple[int, ...]:
        """The spaces of all bridges that have a segment."""
        return tuple(sorted({segment.space for segment in self.segments}))


@dataclass(frozen=True, slots=True)
class PlanView:
    """What splitting needs to know of a fleet."""

    fleet: FleetView
    space_of: Mapping[str, int]
    """The space of each robot that lives behind a bridge."""
    requestors: Mapping[int, frozenset[int]]
    """The spaces that may command each bridge, by its space."""
    of_server: frozenset[str] = frozenset()
    """Names of values that the server says: no bridge has them while it is away."""
    values: Mapping[str, int] = field(default_factory=dict[str, int])
    """The space that says each value, by all names that it has in conditions."""
    hears: Mapping[int, frozenset[int]] = field(default_factory=dict[int, frozenset[int]])
    """The spaces whose values each bridge hears, by its space; of one that is not there nothing is known."""
    on_demand: frozenset[str] = frozenset()
    """Names of values that are read only while the server wants them."""


class Split(NamedTuple):
    """What became of a scenario: a plan, or why it cannot be carried."""

    plan: Plan | None
    problems: tuple[ConfigError, ...]


def missing_requestors(plan: Plan, requestors: Mapping[int, frozenset[int]]) -> list[tuple[int, list[int]]]:
    """The bridges of a plan, by their spaces, that do not take Actions of others which have to reach them."""
    segments = plan.segments
    senders: dict[int, set[int]] = {segment.space: set() for segment in segments}
    ending = {segments[plan.last].space}
    for segment in segments:
        for edge in segment.roads:
            senders[segments[edge.segment].space].add(segment.space)
        if any(isinstance(each, End) for step in segment.steps for each in walked(step)):
            ending.add(segment.space)
    found: list[tuple[int, list[int]]] = []
    for target, spaces in sorted(senders.items()):
        if missing := sorted((spaces | ending) - requestors.get(target, frozenset()) - {target}):
            found.append((target, missing))
    return found
