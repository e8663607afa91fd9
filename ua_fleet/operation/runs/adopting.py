"""What bridges of a carried run are told when others are off; see `carried_adoption`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ua_fleet.carrying import Part, encode_part
from ua_fleet.carrying.adoption import Adoption, FilledSlot, decode_filled, encode_adoption, needed_places
from ua_fleet.carrying.part import PartSegment
from ua_fleet.carrying.token import SegmentRound
from ua_fleet.carrying.words import decode_words
from ua_fleet.scenario import Value
from ua_fleet.scenario.facts import RunAdopted
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
            filled = tuple([slot for slots in self.filled.values() for slot in slots])
            facts = needed_places(self.segments, self.facts, (*filled, *self.begun))
            adoption = Adoption(part, self.gone, self.said.by, filled, self.results, facts, self.stand_ins)
        return encode_adoption(adoption, encode_part(part))

    def take(self, space: int, result: bytes) -> None:
        """A bridge has taken it, and says which tokens it has."""
        (packed,) = unpack(result)
        slots: Sequence[Any] = decode_words(bytes(packed.value or b""), most=len(packed.value or b"")).get("filled", ())
        self.filled[space] = decode_filled(slots)
