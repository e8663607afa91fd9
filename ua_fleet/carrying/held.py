"""A carried run as one bridge knows it: the state that `Holder` makes of its facts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from ua_fleet.carrying.adoption import Adoption, FilledSlot, decode_adoption, filled_slots, proved_over
from ua_fleet.carrying.effects import Begin, Tell
from ua_fleet.carrying.facts import (
    BridgeReturned,
    CarryFact,
    EndTold,
    HandedOver,
    PartAdopted,
    PartTaken,
    PauseTold,
    RunClosed,
    RunDoubted,
    SegmentBegun,
    SegmentOver,
    TokenTaken,
)
from ua_fleet.carrying.part import Part, Road
from ua_fleet.carrying.plan import MailSlot
from ua_fleet.carrying.token import SegmentRound, Token, decode_token, encode_token
from ua_fleet.scenario import Value
from ua_fleet.topics import SERVER_SPACE

__all__ = ["ADOPTED", "CLOCK_STEP_S", "LOST", "HeldRun"]

LOST: Final = "lost"
"""The outcome of a run of which nothing has come for its lease."""
ADOPTED: Final = "adopted"
"""The outcome at a bridge that was away, while another one has gone on in its place: it parks what it has."""
CLOCK_STEP_S: Final = 1.0
"""A clock that was set back by more does not tell how long this bridge was away."""


@dataclass(slots=True)
class HeldRun:
    """A run as this bridge knows it."""

    part: Part
    heard: float
    """When something came of it last, by the wall clock."""
    tokens: dict[tuple[SegmentRound, int], Token] = field(default_factory=dict[tuple[SegmentRound, int], Token])
    """By segment, round and slot."""
    begun: dict[SegmentRound, float] = field(default_factory=dict[SegmentRound, float])
    over: dict[SegmentRound, SegmentOver] = field(default_factory=dict[SegmentRound, SegmentOver])
    handed: set[tuple[SegmentRound, int, int]] = field(default_factory=set[tuple[SegmentRound, int, int]])
    """Segment that is over, and the segment and slot of each token of it that its target has."""
    pause: PauseTold | None = None
    """What was said last, where anything was."""
    closed: RunClosed | None = None
    told: set[int] = field(default_factory=set[int])
    """Who knows that it is over: bridges that have acknowledged the end, and the server (0), which has fetched all."""
    fetched_at: float | None = None
    """When the server has asked for it last: it has fetched all, has ended the run itself, or has left this out."""
    adoptions: list[Adoption] = field(default_factory=list[Adoption])
    """Of the segments of bridges that are off."""
    returned: set[int] = field(default_factory=set[int])
    """Bridges of those that were heard since."""
    unwritten_returned: set[int] = field(default_factory=set[int])
    """The same of which that could not be written down yet."""
    is_doubted: bool = False
    """Whether another bridge may be in the place of this one, which has not heard yet whether it is."""
    passed: dict[int, tuple[int, ...]] = field(default_factory=dict[int, tuple[int, ...]])
    """Rounds of adopted segments that are over, with all before them."""
    asks: set[int] = field(default_factory=set[int])
    """Bridges that have refused a token, and are asked whether it was adopted. Not written down."""
    doubters: set[int] = field(default_factory=set[int])
    """Bridges that were away as well, and have the same epoch. Not written down."""
    stale: str = ""
    """Who has sent a token of an epoch before, for people. Not written down."""
    again_at: float | None = None
    """When what follows from its facts is gone over again, since one could not be written. Not written down."""
    rounds: dict[tuple[tuple[int, ...], tuple[int, ...]], int] = field(
        default_factory=dict[tuple[tuple[int, ...], tuple[int, ...]], int]
    )
    """The newest round of each repetition, by the heads and the rounds of those around it."""

    @property
    def active(self) -> tuple[SegmentRound, ...]:
        """The segments that are under way."""
        return tuple(place for place in self.begun if place not in self.over)

    @property
    def holds(self) -> tuple[SegmentRound, ...]:
        """The segments of which this bridge has a token: under way, or yet to begin; none once the run is over here.

        What is in a mailbox is only told of: it begins nothing.
        """
        places = dict.fromkeys([place for place, _ in self.tokens]) if self.closed is None else ()
        waiting = [one for one in places if not self.part.segments[one.number].tells and not self.is_known(one)]
        return (*self.active, *waiting)

    @property
    def is_paused(self) -> bool:
        """Whether nothing is to be begun."""
        return self.pause is not None and self.pause.is_paused

    @property
    def may_be_lost(self) -> bool:
        """Whether it is over by itself when nothing more comes of it."""
        return self.closed is None and not self.active and not self.is_paused

    def may_be_adopted(self, now: float, *, is_other_boot: bool) -> bool:
        """Whether another bridge may be in its place by now, since this one was away for so long.

        Also where it has no token yet: one that was sent to it before may come late. A clock that was set back, or that
        began anew with the computer, does not tell how long it was.
        """
        waits_s = self.part.adopt_after_s
        is_unknown = is_other_boot or now < self.heard - CLOCK_STEP_S
        is_long = self.is_doubted or (waits_s > 0 and (is_unknown or now - self.heard >= waits_s))
        return self.closed is None and len(self.part.spaces) > 1 and is_long

    def untold(self, space: int) -> list[int]:
        """The bridges that this one, of that space, has yet to tell that the run is over: it has ended it.

        That it has heard nothing of the run for its lease it tells those alone that take something from it.
        """
        if self.closed is None or self.closed.by != space:
            return []
        spaces = sorted(self.part.tells()) if self.closed.outcome == LOST else self.part.spaces
        return [each for each in spaces if each not in self.told and each != space]

    def apply(self, fact: CarryFact) -> None:
        """Take in a fact that is written down; raises PartInvalid or TokenInvalid where another version has."""
        self.heard = max(self.heard, fact.at)
        match fact:
            case TokenTaken():
                names = {number: segment.needs for number, segment in self.part.segments.items()}
                self.take(decode_token(bytes.fromhex(fact.content), names))
            case SegmentBegun():
                self.begun[SegmentRound(fact.segment, fact.rounds)] = fact.at
            case SegmentOver():
                self.over[SegmentRound(fact.segment, fact.rounds)] = fact
            case HandedOver():
                self.handed.add((SegmentRound(fact.segment, fact.rounds), fact.target, fact.slot))
            case RunClosed():
                self.closed = fact
                if fact.by == SERVER_SPACE or fact.outcome == ADOPTED:
                    self.fetched_at = fact.at
            case EndTold():
                self.told.add(fact.space)
                if fact.space == SERVER_SPACE:
                    self.fetched_at = fact.at
            case PauseTold():
                self.pause = fact
            case RunDoubted():
                self.is_doubted = fact.is_doubted
            case BridgeReturned():
                self.returned.add(fact.space)
                self.unwritten_returned.discard(fact.space)
            case PartAdopted():
                self.adopt(decode_adoption(bytes.fromhex(fact.content)), fact.at)
            case PartTaken():
                pass  # it is made of that

    # Tokens.

    def is_known(self, place: SegmentRound) -> bool:
        """Whether a segment was begun or is over in this round, or in one after it."""
        bound = self.passed.get(place.number)
        is_passed = bound is not None and place.rounds[: len(bound)] <= bound
        return place in self.begun or place in self.over or is_passed or self._is_before(place)

    def _is_before(self, place: SegmentRound) -> bool:
        return self._are_before(self.part.segments[place.number].loops, place.rounds)

    def _are_before(self, loops: tuple[int, ...], rounds: tuple[int, ...]) -> bool:
        """Whether one of these rounds is over, since the next one of that repetition has begun."""
        return any(
            number < self.rounds.get((loops[: depth + 1], rounds[:depth]), 0) for depth, number in enumerate(rounds)
        )

    def take(self, token: Token) -> None:
        """Keep a token. The first one of a round says that those before it are over: they are forgotten."""
        place = token.place
        self.tokens[place, token.slot] = token
        loops = self.part.segments[place.number].loops
        for depth, number in enumerate(place.rounds):
            key = loops[: depth + 1], place.rounds[:depth]
            if number > self.rounds.get(key, 0):
                self.rounds[key] = number
                self._forget_rounds()

    def _forget_rounds(self) -> None:
        """A repetition has one round at a time. What was not handed over of one before stays.

        So does the newest of each mailbox, since who hears it may begin later, outside of the repetition; and the
        newest end of each segment, since an heir may need what was told to a mailbox of a bridge that is off.
        """
        heard = _newest([key for key in self.tokens if self.part.segments[key[0].number].tells])
        self.tokens = {key: token for key, token in self.tokens.items() if key in heard or not self._is_before(key[0])}
        ends = _newest([(place, 0) for place in self.over])
        gone = [
            place
            for place, over in self.over.items()
            if self._is_before(place)
            and (place, 0) not in ends
            and all((place, road.segment, road.slot) in self.handed for road in self.roads(place, over))
        ]
        for place in gone:
            del self.over[place]
            self.begun.pop(place, None)
        self.rounds = {key: number for key, number in self.rounds.items() if not self._are_before(*key)}
        if gone:
            self.handed = {key for key in self.handed if key[0] in self.over}

    def values(self, place: SegmentRound) -> dict[str, Value]:
        """The results that the tokens of a segment hold."""
        values: dict[str, Value] = {}
        for slot in range(self.part.segments[place.number].slots):
            token = self.tokens.get((place, slot))
            if token is not None:
                values |= token.values
        return values

    def begin(self, place: SegmentRound) -> Begin:
        """What the engine is to run."""
        part = self.part
        segment = part.segments[place.number]
        outside = tuple([part.segments[heard.mailbox].tells for heard in segment.hears])
        facts = next((one.facts[str(place)] for one in self.adoptions if str(place) in one.facts), ())
        stand_ins: Mapping[str, Mapping[str, str]] = self.adoptions[-1].stand_ins if self.adoptions else {}
        return Begin(part.run_id, segment, place.rounds, self.values(place), outside, facts, stand_ins)

    def tells(self, place: SegmentRound) -> list[Tell]:
        """What a segment hears of other branches, as far as it is known."""
        return [tell for heard in self.part.segments[place.number].hears for tell in self._tell(place, *heard)]

    def hearers(self, mailbox: int) -> list[SegmentRound]:
        """The segments under way that hear what comes to a mailbox."""
        segments = self.part.segments
        return [place for place in self.active if mailbox in [one.mailbox for one in segments[place.number].hears]]

    def _tell(self, place: SegmentRound, mailbox: int, loops: int) -> Iterator[Tell]:
        """The newest that has come in the same rounds of the repetitions around both."""
        there = [
            (slot == MailSlot.DONE, at.rounds, token)
            for (at, slot), token in self.tokens.items()
            if at.number == mailbox and at.rounds[:loops] == place.rounds[:loops]
        ]
        if there:
            is_done, _, token = max(there, key=lambda one: one[:2])
            results = {name.partition(".")[2]: value for name, value in token.values.items()}
            yield Tell(self.part.run_id, place, self.part.segments[mailbox].tells, is_done, results)

    def roads(self, place: SegmentRound, over: SegmentOver) -> tuple[Road, ...]:
        """Where tokens go from a segment that is over; nowhere from the last one."""
        segment = self.part.segments[place.number]
        if over.ends:
            return ()
        if over.failed:
            return (*(() if segment.fails is None else (segment.fails,)), *segment.lost)
        return segment.then if over.way else segment.otherwise

    def token(self, place: SegmentRound, over: SegmentOver, road: Road) -> bytes:
        """The token for one of them; raises TokenInvalid where a result does not fit."""
        part, there = self.part, road.place(place.rounds)
        values = {name: over.results[name] for name in road.needs if name in over.results}
        is_lost = road in part.segments[place.number].lost
        failed = "" if is_lost else over.failed
        token = Token(part.run_id, part.plan_hash, part.epoch, road.segment, road.slot, failed, values, there.rounds)
        return encode_token(token, road.needs)

    # A bridge that is off.

    def off(self) -> list[tuple[int, str]]:
        """The bridges that a person has said to be off, with that person, and that were not heard since."""
        back = self.returned | self.unwritten_returned
        return [(gone, one.by) for one in self.adoptions for gone in one.gone if gone not in back]

    def filled(self) -> tuple[FilledSlot, ...]:
        """What this bridge says of the tokens that it has."""
        return filled_slots(self.tokens.values(), self.part.segments)

    def adopt(self, adoption: Adoption, at: float) -> None:
        """Go by the new part: what the bridge that is off had goes to its heir once more."""
        before, self.part = self.part, adoption.part
        self.adoptions.append(adoption)
        self.returned.difference_update(adoption.gone)  # it may be off once more
        self.unwritten_returned.difference_update(adoption.gone)
        self.asks.clear()
        self.doubters.clear()
        lost = {
            (segment.number, road.segment, road.slot)
            for segment in before.segments.values()
            for road in segment.roads
            if road.space in adoption.gone
        }
        self.handed = {key for key in self.handed if (key[0].number, *key[1:]) not in lost}
        adopted = {number: one for number, one in self.part.segments.items() if number not in before.segments}
        filled = sorted((*adoption.filled, *self.filled()), key=lambda slot: slot.rounds)
        known = dict(adoption.results)
        for slot in filled:
            known |= slot.values
        proved = proved_over(adopted, filled)
        self.passed |= proved.passed
        for place, (failed, way) in proved.over.items():
            results = {} if failed else known
            self.over[place] = SegmentOver(
                at, self.part.run_id, place.number, failed, results, rounds=place.rounds, way=way
            )
        first = SegmentRound(0)
        if 0 in adopted and (first, 0) not in self.tokens:
            self.tokens[first, 0] = Token(self.part.run_id, self.part.plan_hash, self.part.epoch, 0, 0)


def _newest(places: Iterable[tuple[SegmentRound, int]]) -> set[tuple[SegmentRound, int]]:
    """Of each segment and slot, the one in the newest round."""
    newest: dict[tuple[int, int], tuple[SegmentRound, int]] = {}
    for place, slot in sorted(places, key=lambda one: one[0].rounds):
        newest[place.number, slot] = place, slot
    return set(newest.values())
