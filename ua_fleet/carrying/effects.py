"""What follows from what a holder knows: for the engine of its bridge, and for other bridges."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from ua_fleet.carrying.part import PartSegment, Road
from ua_fleet.carrying.token import SegmentRound
from ua_fleet.scenario import Value
from ua_fleet.scenario.facts import Fact, RunClosing, RunOutcome, RunPaused, RunResumed

__all__ = [
    "AskEpoch",
    "Begin",
    "Carry",
    "Gone",
    "Pause",
    "Send",
    "SendEnd",
    "SendToken",
    "Stop",
    "Tell",
    "fact_before",
]


class Begin(NamedTuple):
    """Have the engine run a segment in one round; said again for one that it has, nothing happens."""

    run_id: str
    segment: PartSegment
    rounds: tuple[int, ...]
    values: dict[str, Value]
    """Results of segments before."""
    outside: tuple[str, ...] = ()
    """Tasks of other branches of which it hears: see `Tell`."""
    facts: tuple[str, ...] = ()
    """Lines of what was done of it already, at a bridge that is off."""
    stand_ins: Mapping[str, Mapping[str, str]] = MappingProxyType({})
    """Who stands in for robots by their capacities, as far as was known when a bridge was left out."""


class Tell(NamedTuple):
    """Tell the engine what became of a task of another branch; said again, nothing happens."""

    run_id: str
    place: SegmentRound
    task: str
    is_done: bool
    """Else it was not done, and will not be."""
    results: dict[str, Value]
    """By their names, without the task's."""


class Gone(NamedTuple):
    """A person has said that a bridge is off: the engine knows that its robots can do nothing."""

    run_id: str
    space: int
    by: str


class SendToken(NamedTuple):
    """A token that its target has not acknowledged."""

    run_id: str
    source: SegmentRound
    road: Road
    content: bytes


class SendEnd(NamedTuple):
    """The end of a run, which a bridge has not acknowledged."""

    run_id: str
    space: int
    outcome: str
    reason: str


class AskEpoch(NamedTuple):
    """A bridge is asked whether the token of this one was adopted meanwhile."""

    run_id: str
    space: int
    epoch: int = 1
    """That this bridge knows."""


class Stop(NamedTuple):
    """Have the engine end what it has of a run."""

    run_id: str
    places: tuple[SegmentRound, ...]
    reason: str


class Pause(NamedTuple):
    """Have the engine begin no further task of these segments, or go on with them."""

    run_id: str
    places: tuple[SegmentRound, ...]
    is_paused: bool
    by: str


Carry = Begin | Gone | Pause | Stop | Tell
Send = SendToken | SendEnd | AskEpoch


def fact_before(effect: Pause | Stop, now: float) -> Fact:
    """What the journal of a segment gets before its engine goes on after a restart, so that nothing is begun first."""
    if isinstance(effect, Stop):
        return RunClosing(now, RunOutcome.ABORTED, effect.reason)
    return RunPaused(now, effect.by) if effect.is_paused else RunResumed(now, effect.by)
