"""What bridges of a carried run are told when others are off; see `carried_adoption`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

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
from ua_fleet.carrying.part import PartSegment
from ua_fleet.carrying.proof import heads_alone, proved_over
from ua_fleet.carrying.token import SegmentRound
from ua_fleet.carrying.words import decode_words
from ua_fleet.scenario import Value
from ua_fleet.scenario.facts import RunAdopted, decode_fact
from ua_fleet.skill.executions import unpack

__all__ = ["Adopting"]


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
    filled: dict[int, tuple[FilledSlot, ...]] = field(default_factory=dict[int, tuple[FilledSlot, ...]])
    """What the others have, by their spaces."""

    @property
    def gone(self) -> tuple[int, ...]:
        """The spaces of the bridges that are off."""
        return (*self.said.also, self.said.space)

    def may_be_told(self, space: int) -> bool:
        """Whether a bridge can be told now: the heir is the last one, and gets what the others have."""
        return space != self.said.heir or self.filled.keys() >= self.parts.keys() - {space}

    def content_for(self, space: int) -> bytes:
        """What one bridge is told; raises PartInvalid where it is too large."""
        part = self.parts[space]
        adoption = Adoption(part, self.gone, self.said.by)
        if space == self.said.heir:
            own = begun_places(self.segments, self.facts, self.results)
            filled = (*[slot for slots in self.filled.values() for slot in slots], *own)
            facts = needed_places(self.segments, self.facts, (*filled, *self.begun))
            adoption = Adoption(part, self.gone, self.said.by, filled, self.results, facts, self.stand_ins)
        return encode_adoption(adoption, encode_part(part))

    def unknown_rounds(self) -> tuple[str, str] | None:
        """A repetition of which bridges that are off may have done rounds that nobody has heard of, since no other one
        takes part in them, and no person has named the last one of them; None where there is none.

        Returns:
            The name of a task in it, and the round of which was heard last; empty where none was.
        """
        own = begun_places(self.segments, self.facts)
        proved = proved_over(self.segments, (*self.begun, *own))
        for head in heads_alone(self.segments):
            depth = len(self.segments[head].loops)
            within = [one for one in self.segments.values() if head in one.loops]
            tasks = [task for one in within for task in one.tasks()]
            if not tasks or proved.passed.get(head) == ():
                continue
            heard = max((place.rounds[:depth] for place in self._heard(within)), default=())
            least = (*heard[:-1], heard[-1] - 1) if heard else ()
            said = rounds_said(tasks, self.said.done)
            if not any(one is None or one[:depth] >= least for one in said):
                return tasks[0].name or tasks[0].key, "@".join(map(str, heard))
        return None

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
