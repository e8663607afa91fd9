"""What follows from what a holder knows: for the engine of its bridge, and for other bridges."""

from __future__ import annotations

from typing import NamedTuple

from ua_fleet.carrying.part import PartSegment, Road
from ua_fleet.scenario import Value
from ua_fleet.scenario.facts import Fact, RunClosing, RunOutcome, RunPaused, RunResumed

__all__ = ["AskEpoch", "Begin", "Carry", "Gone", "Pause", "Send", "SendEnd", "SendToken", "Stop", "fact_before"]


class Begin(NamedTuple):
    """Have the engine run a segment; said again for one that it has, nothing happens."""

    run_id: str
    segment: PartSegment
    values: dict[str, Value]
    """Results of segments before."""
    facts: tuple[str, ...] = ()
    """Lines of what was done of it already, at a bridge that is off."""


class Gone(NamedTuple):
    """A person has said that a bridge is off: the engine knows that its robots can do nothing."""

    run_id: str
    space: int
    by: str


class SendToken(NamedTuple):
    """A token that its target has not acknowledged."""

    run_id: str
    segment: int
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


class Stop(NamedTuple):
    """Have the engine end what it has of a run."""

    run_id: str
    segments: tuple[int, ...]
    reason: str


class Pause(NamedTuple):
    """Have the engine begin no further task of these segments, or go on with them."""

    run_id: str
    segments: tuple[int, ...]
    is_paused: bool
    by: str


Carry = Begin | Gone | Pause | Stop
Send = SendToken | SendEnd | AskEpoch


def fact_before(effect: Pause | Stop, now: float) -> Fact:
    """What the journal of a segment gets before its engine goes on after a restart, so that nothing is begun first."""
    if isinstance(effect, Stop):
        return RunClosing(now, RunOutcome.ABORTED, effect.reason)
    return RunPaused(now, effect.by) if effect.is_paused else RunResumed(now, effect.by)
