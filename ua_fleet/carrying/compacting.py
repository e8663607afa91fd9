"""Which facts of a carried run a bridge needs no more, since others came after them. Pure.

A `repeat` may have a million rounds. Of rounds that are over a holder keeps what may still be asked for (see
`HeldRun._forget_rounds`); facts of what it has forgotten change nothing when the journal is read again. What was
written before a bridge was left out stays: an adoption goes by what there was then.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ua_fleet.carrying.facts import CarryFact, HandedOver, PartAdopted, SegmentBegun, SegmentOver, TokenTaken
from ua_fleet.carrying.held import HeldRun
from ua_fleet.carrying.part import segment_of
from ua_fleet.carrying.token import SegmentRound, TokenInvalid, decode_token

__all__ = ["forgotten_segments", "superseded"]


def superseded(held: HeldRun, facts: Sequence[CarryFact]) -> list[int]:
    """The places in the journal of the facts of a run that are needed no more; never of the last one.

    Args:
        held: what all of them have made.
        facts: of the run, in their order.
    """
    adoptions = [number for number, fact in enumerate(facts) if isinstance(fact, PartAdopted)]
    first = adoptions[-1] + 1 if adoptions else 0
    return [number for number in range(first, len(facts) - 1) if _is_superseded(held, facts[number])]


def _is_superseded(held: HeldRun, fact: CarryFact) -> bool:
    match fact:
        case TokenTaken():
            try:
                token = decode_token(bytes.fromhex(fact.content))
            except TokenInvalid:
                return False
            return (token.place, token.slot) not in held.tokens
        case SegmentBegun():
            return SegmentRound(fact.segment, fact.rounds) not in held.begun
        case SegmentOver():
            return SegmentRound(fact.segment, fact.rounds) not in held.over
        case HandedOver():
            return (SegmentRound(fact.segment, fact.rounds), fact.target, fact.slot) not in held.handed
        case _:
            return False


def forgotten_segments(held: HeldRun, segments: Iterable[str]) -> list[str]:
    """Those of some ids of segments' runs which are over, and of rounds that are; in their order."""
    places = [(segment, segment_of(segment)[1]) for segment in segments]
    return [
        segment
        for segment, place in places
        if place.number in held.part.segments
        and place not in held.begun
        and place not in held.over
        and held.is_known(place)
    ]
