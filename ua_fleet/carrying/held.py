"""A carried run as one bridge knows it: the state that `Holder` makes of its facts."""

from __future__ import annotations

from dataclasses import dataclass, field

from ua_fleet.carrying.adoption import Adoption, filled_slots, proved_over
from ua_fleet.carrying.facts import PauseTold, RunClosed, SegmentOver
from ua_fleet.carrying.part import Part
from ua_fleet.carrying.token import Token

__all__ = ["HeldRun"]


@dataclass(slots=True)
class HeldRun:
    """A run as this bridge knows it."""

    part: Part
    heard: float
    """When something came of it last, by the wall clock."""
    tokens: dict[tuple[int, int], Token] = field(default_factory=dict[tuple[int, int], Token])
    """By segment and slot."""
    begun: dict[int, float] = field(default_factory=dict[int, float])
    over: dict[int, SegmentOver] = field(default_factory=dict[int, SegmentOver])
    handed: set[tuple[int, int, int]] = field(default_factory=set[tuple[int, int, int]])
    """Segment that is over, and the segment and slot of each token of it that its target has."""
    pause: PauseTold | None = None
    """What was said last, where anything was."""
    closed: RunClosed | None = None
    told: set[int] = field(default_factory=set[int])
    """Bridges that have acknowledged the end."""
    adoption: Adoption | None = None
    """Of the segments of a bridge that is off."""
    asks: set[int] = field(default_factory=set[int])
    """Bridges that have refused a token, and are asked whether it was adopted. Not written down."""
    stale: str = ""
    """Who has sent a token of an epoch before, for people. Not written down."""

    @property
    def active(self) -> tuple[int, ...]:
        """The segments that are under way."""
        return tuple(number for number in self.begun if number not in self.over)

    @property
    def is_paused(self) -> bool:
        """Whether nothing is to be begun."""
        return self.pause is not None and self.pause.is_paused

    @property
    def may_be_lost(self) -> bool:
        """Whether it is over by itself when nothing more comes of it."""
        return self.closed is None and not self.active and not self.is_paused

    def may_be_adopted(self, now: float) -> bool:
        """Whether another bridge may be in its place by now, since this one was away for so long.

        Also where it has no token yet: one that was sent to it before may come late.
        """
        waits_s = self.part.adopt_after_s
        return self.closed is None and len(self.part.spaces) > 1 and 0 < waits_s <= now - self.heard

    def adopt(self, adoption: Adoption, at: float) -> None:
        """Go by the new part: what the bridge that is off had goes to its heir once more."""
        before, self.part, self.adoption = self.part, adoption.part, adoption
        lost = {
            (segment.number, road.segment, road.slot)
            for segment in before.segments.values()
            for road in (*segment.then, *([] if segment.fails is None else [segment.fails]))
            if road.space == adoption.gone
        }
        self.handed -= lost
        adopted = {number: one for number, one in self.part.segments.items() if number not in before.segments}
        filled = [*adoption.filled, *filled_slots(self.tokens.values())]
        known = dict(adoption.results)
        for slot in filled:
            known |= slot.values
        for number, failed in proved_over(adopted, filled).items():
            self.over[number] = SegmentOver(at, self.part.run_id, number, failed, {} if failed else known)
        if 0 in adopted and (0, 0) not in self.tokens:
            self.tokens[0, 0] = Token(self.part.run_id, self.part.plan_hash, self.part.epoch, 0, 0)
