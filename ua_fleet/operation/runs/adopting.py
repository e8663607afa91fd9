"""What bridges of a carried run are told when others are off; see `carried_adoption`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ua_fleet.carrying import Part, encode_part
from ua_fleet.carrying.adoption import (
    Adoption,
    FilledSlot,
    begun_places,
    decode_filled,
    encode_adoption,
    needed_places,
    rounds_said,
)
from ua_fleet.carrying.named_rounds import times_of, why_unclear
from ua_fleet.carrying.part import PartInvalid, PartSegment
from ua_fleet.carrying.proof import heads_alone, needed_slots, proved_over
from ua_fleet.carrying.token import SegmentRound
from ua_fleet.carrying.whole_repeats import WholeRepeat
from ua_fleet.carrying.words import decode_words
from ua_fleet.scenario import Value
from ua_fleet.scenario.facts import RunAdopted, StepEnded, decode_fact
from ua_fleet.scenario.model import Task
from ua_fleet.skill.executions import unpack

__all__ = ["Adopting", "UnknownRounds"]


class UnknownRounds(NamedTuple):
    """A repetition of which more rounds may be done than anybody has heard of."""

    spaces: tuple[int, ...]
    """Of the bridges that may have done them."""
    tasks: tuple[Task, ...]
    """All that these do in a round."""
    heard: str
    """The round that was heard of last, as `4@2` within two repetitions; empty where none was."""


@dataclass(slots=True)
class Adopting:
    """An adoption that the bridges are told of."""

    said: RunAdopted
    parts: Mapping[int, Part]
    results: Mapping[str, Value]
    segments: Mapping[int, PartSegment]
    """Of the bridges that are off."""
    facts: Mapping[SegmentRound, tuple[str, ...]]
    """What is known of them."""
    begun: Sequence[FilledSlot]
    """Tokens that the others have, or newer ones, as facts of theirs say."""
    stand_ins: Mapping[str, Mapping[str, str]]
    """Who stands in for robots, as far as was fetched."""
    homes: Mapping[int, int]
    """The space of the bridge that has each of the segments."""
    repeats: Sequence[WholeRepeat] = ()
    """Those within segments, of whose rounds no token tells."""
    heads: Mapping[str, int] = field(default_factory=dict[str, int])
    """Repetitions whose rounds a bridge begins that is left, and has since the run began: its space, by their keys."""
    filled: dict[int, tuple[FilledSlot, ...]] = field(default_factory=dict[int, tuple[FilledSlot, ...]])
    """What the others have, by their spaces."""
    problems: dict[int, str] = field(default_factory=dict[int, str])
    """Why bridges cannot be told, by their spaces: what the others have is too large."""

    @property
    def gone(self) -> tuple[int, ...]:
        """The spaces of the bridges that are off."""
        return (*self.said.also, self.said.space)

    def may_be_told(self, space: int) -> bool:
        """Whether a bridge can be told now: the heir is the last one, and gets what the others have."""
        return space != self.said.heir or self.filled.keys() >= self.parts.keys() - {space}

    def told_to(self, space: int) -> bytes | None:
        """What one bridge is told now; None where it cannot be: it waits for others, or `problems` has the reason."""
        self.problems.pop(space, None)
        try:
            return self.content_for(space) if self.may_be_told(space) else None
        except PartInvalid as error:
            self.problems[space] = str(error)
            return None

    def content_for(self, space: int) -> bytes:
        """What one bridge is told; raises PartInvalid where it is too large."""
        part = self.parts[space]
        adoption = Adoption(part, self.gone, self.said.by)
        if space == self.said.heir:
            own = begun_places(self.segments, self.facts, self.results)
            others = needed_slots(self.segments, [slot for slots in self.filled.values() for slot in slots])
            filled = (*others, *own)
            facts = needed_places(self.segments, self.facts, (*filled, *self.begun))
            adoption = Adoption(part, self.gone, self.said.by, filled, self.results, facts, self.stand_ins)
        return encode_adoption(adoption, encode_part(part))

    def why_unclear(self, done: Sequence[str], begun: Mapping[str, tuple[int, ...]]) -> str:
        """Why what a person says is done cannot be taken; empty where it can.

        The heir of a round that none of the others begins would wait for ever.

        Args:
            done: what the person says.
            begun: the newest round of repetitions, by their keys: of those of `heads` of which all was fetched.
        """
        tasks = [task for one in self.segments.values() for task in one.tasks()]
        every = [one for part in self.parts.values() for one in part.segments.values()]
        times = times_of(step for one in every for step in one.body.steps)
        return next((why for name in done if (why := why_unclear(name, tasks, times, begun))), "")

    def unknown_rounds(self) -> UnknownRounds | None:
        """A repetition of which bridges that are off may have done rounds that nobody has heard of, since no other one
        takes part in them, and no person has named the last one of them; None where there is none.

        All that a bridge has recorded may have been fetched: while it is silent it may go on, cut off from the server
        alone. Those of bridges that were left out before are known, or were named then.
        """
        own = begun_places(self.segments, self.facts)
        proved = proved_over(self.segments, (*self.begun, *own))
        before = {number: one for number, one in self.segments.items() if self.homes[number] != self.said.space}
        settled = heads_alone(before)
        for head in heads_alone(self.segments):
            if head in settled or proved.passed.get(head) == () or self._has_ended(head):
                continue
            depth, within = len(self.segments[head].loops), [one for one in self.segments.values() if head in one.loops]
            heard = [place.rounds[:depth] for place in self._heard(within)]
            tasks = [task for one in within for task in one.tasks()]
            if not self._is_named(tasks, depth, heard):
                return self._unknown(within, tasks, heard)
        for repeat in self.repeats:
            number = repeat.segment
            if number in before or repeat.is_over or proved.passed.get(number) == ():
                continue
            if not self._is_named(repeat.tasks, repeat.depth, [repeat.heard]):
                return self._unknown([self.segments[number]], repeat.tasks, [repeat.heard])
        return None

    def _has_ended(self, head: int) -> bool:
        """Whether facts say that a repetition begins no further round: never where another one may begin it anew."""
        lines = [line for place, known in self.facts.items() if place.number == head for line in known]
        is_ended = any(isinstance(decode_fact(line), StepEnded) for line in lines)
        return is_ended and len(self.segments[head].loops) == 1

    def _is_named(self, tasks: Sequence[Task], depth: int, heard: Iterable[tuple[int, ...]]) -> bool:
        """Whether a person has named a last round of a repetition that may be it, as to what was heard."""
        newest = max(heard, default=())
        least = (*newest[:-1], newest[-1] - 1) if newest else ()
        said = rounds_said(tasks, self.said.done)
        return not tasks or any(one is None or one[:depth] >= least for one in said)

    def _unknown(
        self, within: Sequence[PartSegment], tasks: Sequence[Task], heard: Iterable[tuple[int, ...]]
    ) -> UnknownRounds:
        spaces = tuple(dict.fromkeys([self.homes[one.number] for one in within if one.tasks()]))
        return UnknownRounds(spaces, tuple(tasks), "@".join(map(str, max(heard, default=()))))

    def _heard(self, within: Iterable[PartSegment]) -> Iterator[SegmentRound]:
        """In which rounds of these segments anything is known that no person has said."""
        numbers = {one.number for one in within}
        for place, lines in self.facts.items():
            if place.number in numbers and any(getattr(decode_fact(line), "at", 0.0) < self.said.at for line in lines):
                yield place

    def take(self, space: int, result: bytes) -> None:
        """A bridge has taken it, and says which tokens it has."""
        (packed,) = unpack(result)
        slots: Sequence[Any] = decode_words(bytes(packed.value or b""), most=len(packed.value or b"")).get("filled", ())
        self.filled[space] = decode_filled(slots)
