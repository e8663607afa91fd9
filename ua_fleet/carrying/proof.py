"""What the tokens that bridges have prove of the segments of others: see `adoption`. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from math import inf
from typing import NamedTuple

from ua_fleet.carrying.part import PartSegment, Road
from ua_fleet.carrying.token import SegmentRound
from ua_fleet.scenario import Value

__all__ = ["FilledSlot", "Proved", "heads_alone", "needed_slots", "proved_over"]


class FilledSlot(NamedTuple):
    """A token that a bridge has, without what only it needs."""

    segment: int
    slot: int
    failed: str
    values: Mapping[str, Value]
    rounds: tuple[int, ...] = ()
    loops: tuple[int, ...] = ()
    """The heads of the repetitions around that segment."""


class Proved(NamedTuple):
    """What tokens prove of the segments of a bridge that is off."""

    over: dict[SegmentRound, tuple[str, bool]]
    """Those that are over, with why they have failed (empty where they have not), and what they have decided."""
    passed: dict[int, tuple[int, ...]]
    """By the number of a segment: it is over in all rounds that begin with these, or with some before them."""

    def is_passed(self, place: SegmentRound) -> bool:
        """Whether a segment is over in this round."""
        bound = self.passed.get(place.number)
        return bound is not None and place.rounds[: len(bound)] <= bound


def proved_over(segments: Mapping[int, PartSegment], filled: Iterable[FilledSlot]) -> Proved:
    """Who has a token of a segment proves that this segment is over, and all that lead to it, in rounds before, too."""
    proof = _Proof(segments)
    for slot in filled:
        proof.take(slot)
    return proof.proved


def needed_slots(segments: Mapping[int, PartSegment], filled: Iterable[FilledSlot]) -> list[FilledSlot]:
    """Of the tokens that others have, what the heir of segments has to know: what proves some of these to be over, and
    results that their tokens are made of.
    """
    names = {name for one in segments.values() for road in one.roads for name in road.needs}
    found: list[FilledSlot] = []
    for slot in filled:
        values = {name: value for name, value in slot.values.items() if name in names}
        if values or any(proved_over(segments, [slot])):
            found.append(slot._replace(values=values))
    return found


def heads_alone(segments: Mapping[int, PartSegment]) -> list[int]:
    """The heads of the repetitions whose rounds one bridge may do one after the other, while no other one hears of it.

    Args:
        segments: of that bridge.
    """
    return [number for number, one in segments.items() if number in one.loops[-1:] and _goes_round(number, segments)]


def _goes_round(head: int, segments: Mapping[int, PartSegment]) -> bool:
    """Whether the next round can begin with tokens of these segments alone."""
    done, filled, left = set[int](), set[tuple[int, int]](), [head]
    while left:
        number = left.pop()
        done.add(number)
        for road in (*segments[number].then, *segments[number].otherwise):
            if road.is_next and road.segment == head:
                return True
            target = segments.get(road.segment)
            filled.add((road.segment, road.slot))
            if target is None or road.segment in done or target.tells:
                continue
            if all((road.segment, slot) in filled for slot in range(target.slots)):
                left.append(road.segment)
    return False


class _Proof:
    """What follows from tokens."""

    def __init__(self, segments: Mapping[int, PartSegment]) -> None:
        self._segments, self.proved = segments, Proved({}, {})

    def take(self, slot: FilledSlot) -> None:
        """Somebody has a token."""
        left: list[SegmentRound] = []
        for number, segment in self._segments.items():
            if (before := _round_before(segment.loops, slot)) is not None:
                self._pass(number, before)
            road = segment.fails
            if slot.failed and road is not None and (road.segment, road.slot) == (slot.segment, slot.slot):
                left += self._add(number, slot.rounds[: road.kept], slot.failed)
        if not slot.failed:
            left += self._look_before(SegmentRound(slot.segment, slot.rounds), slot.slot)
        while left:
            left += self._look_before(left.pop(), None)

    def _look_before(self, target: SegmentRound, slot: int | None) -> Iterator[SegmentRound]:
        """Add what leads to a slot of a segment, or to all of one that is over itself; what is new of it."""
        for number, segment in self._segments.items():
            for road in (*segment.then, *segment.otherwise):
                rounds = _rounds_before(road, target.rounds)
                if road.segment == target.number and slot in (None, road.slot) and rounds is not None:
                    is_exact = slot is not None or not road.is_next
                    yield from self._add(number, rounds, way=road in segment.then, is_exact=is_exact)

    def _add(
        self, number: int, rounds: tuple[int, ...], failed: str = "", *, way: bool = True, is_exact: bool = True
    ) -> Iterator[SegmentRound]:
        place, is_new = SegmentRound(number, rounds), self._pass(number, rounds)
        loops = len(self._segments[number].loops)
        if is_exact and len(rounds) == loops and place not in self.proved.over:
            self.proved.over[place], is_new = (failed, way), True
        elif is_exact and len(rounds) < loops and not failed:
            # A repetition was left, in a round that is not known. What is behind it gets its token whatever round it
            # was: where nobody else has that token, the heir has to make it.
            left = SegmentRound(number, (*rounds, *[0] * (loops - len(rounds))))
            self.proved.over.setdefault(left, ("", way))
        if is_new:
            yield place

    def _pass(self, number: int, rounds: tuple[int, ...]) -> bool:
        """Know that a segment is over up to these rounds; whether that is new."""
        loops, known = len(self._segments[number].loops), self.proved.passed.get(number)
        is_new = known is None or _padded(rounds, loops) > _padded(known, loops)
        if is_new:
            self.proved.passed[number] = rounds
        return is_new


def _padded(rounds: tuple[int, ...], loops: int) -> tuple[float, ...]:
    """Rounds so that those compare as greater which say more: of repetitions that are not told, all are over."""
    return (*rounds, *[inf] * (loops - len(rounds)))


def _rounds_before(road: Road, rounds: tuple[int, ...]) -> tuple[int, ...] | None:
    """The rounds of the segment from which a token came by a road, as far as the road keeps them; None: by another."""
    kept = rounds[: road.kept]
    if not road.is_next or len(kept) < road.kept:
        return kept
    return (*kept[:-1], kept[-1] - 1) if kept[-1] > 0 else None


def _round_before(loops: tuple[int, ...], slot: FilledSlot) -> tuple[int, ...] | None:
    """The last round of the repetitions around both that is over, since another one has begun; None: there is none."""
    common = 0
    while common < min(len(loops), len(slot.loops)) and loops[common] == slot.loops[common]:
        common += 1
    kept = slot.rounds[:common]
    while kept and kept[-1] == 0:
        kept = kept[:-1]
    return (*kept[:-1], kept[-1] - 1) if kept else None
