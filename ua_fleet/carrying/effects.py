"""What follows from what a holder knows: for the engine of its bridge, and for other bridges."""

from __future__ import annotations

from typing import NamedTuple

from ua_fleet.carrying.part import PartSegment, Road
from ua_fleet.scenario import Value

__all__ = ["Begin", "Carry", "Pause", "SendEnd", "SendToken", "Stop"]


class Begin(NamedTuple):
    """Have the engine run a segment; said again for one that it has, nothing happens."""

    run_id: str
    segment: PartSegment
    values: dict[str, Value]
    """Results of segments before."""


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


Carry = Begin | Pause | Stop
