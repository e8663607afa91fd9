"""The codec that publishers and subscribers use: the generic one, with compiled plans in front of it."""

from __future__ import annotations

from typing import Final, TypeVar

from ua_fleet.wire.builtin import MISFITS
from ua_fleet.wire.decode_plan import (
    GIVE_UP,
    MOST_PLANNED_FIELDS,
    DecodePlan,
    PlanFactory,
    PlanLayout,
    compile_layout,
    make_plan,
    prefix_length,
)
from ua_fleet.wire.encode_plan import WriterPlan
from ua_fleet.wire.generic import Decoded, decode_message, encode_message
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage

__all__ = ["Codec"]

USUAL_PREFIX_LENGTH: Final = 12
"""Length of the constant first bytes of what our own publishers send."""
USUAL_PREFIX: Final = slice(USUAL_PREFIX_LENGTH)

MOST_PLANS: Final = 16_384
"""Writers whose plans, or layouts seen once, a codec remembers; the oldest go first."""
MOST_LAYOUTS: Final = 256
"""Generated functions that it keeps; writers with the same fields share one."""

FULL_CREDIT: Final = 1000
COST_OF_A_LAYOUT: Final = 16
"""A message that no plan fits earns one credit, generating a function costs so many: a peer that changes its fields all
the time gets the generic codec and not a compiler."""

_Writer = tuple[int | str | None, int | None, int]


class Codec:
    """Encodes and decodes UADP messages. Compiled plans make known layouts fast; the result is the same."""

    __slots__ = ("_credit", "_layouts", "_packed_arrays", "_plans", "_seen", "_writer_plans")

    def __init__(self, *, packed_arrays: bool = False) -> None:
        """Make one; with `packed_arrays` arrays and ByteStrings may be views of the message (see `packed.py`)."""
        self._packed_arrays = packed_arrays
        self._plans: dict[bytes, DecodePlan] = {}
        self._seen: dict[bytes, PlanLayout] = {}
        self._layouts: dict[PlanLayout, PlanFactory] = {}
        self._writer_plans: dict[_Writer, WriterPlan] = {}
        self._credit = FULL_CREDIT

    def decode(self, datagram: bytes) -> Decoded:
        """Decode one datagram; raises RemoteWireError and nothing else."""
        try:
            return self._plans[datagram[USUAL_PREFIX]](datagram)
        except GIVE_UP:
            pass
        return self._decode_without_usual_plan(datagram)

    def _decode_without_usual_plan(self, datagram: bytes) -> Decoded:
        length = prefix_length(datagram)
        if not length:
            return decode_message(datagram)
        prefix = datagram[:length]
        if length != USUAL_PREFIX_LENGTH and prefix in self._plans:
            try:
                return self._plans[prefix](datagram)
            except GIVE_UP:
                pass
        message = decode_message(datagram)
        if isinstance(message, NetworkMessage):
            self._learn(prefix, datagram, message)
        return message

    def _learn(self, prefix: bytes, datagram: bytes, message: NetworkMessage) -> None:
        """Make a plan where a writer's layout is seen for the second time in a row."""
        part = message.messages[0]
        self._credit = min(self._credit + 1, FULL_CREDIT)
        if not 0 < len(part.types) <= MOST_PLANNED_FIELDS:
            return
        layout = PlanLayout(
            len(prefix),
            part.sequence_number is not None,
            part.timestamp is not None,
            part.status is not None,
            part.major_version is not None,
            part.minor_version is not None,
            part.types,
        )
        if self._seen.get(prefix) != layout:
            _remember(self._seen, prefix, layout, MOST_PLANS)
            return
        make = self._layouts.get(layout) or self._compile(layout)
        plan = make and make_plan(make, layout, datagram, message)
        if plan is not None:
            _remember(self._plans, prefix, plan, MOST_PLANS)

    def _compile(self, layout: PlanLayout) -> PlanFactory | None:
        if self._credit < COST_OF_A_LAYOUT:
            return None
        self._credit -= COST_OF_A_LAYOUT
        make = compile_layout(layout, packed_arrays=self._packed_arrays)
        _remember(self._layouts, layout, make, MOST_LAYOUTS)
        return make

    def encode(self, message: NetworkMessage) -> bytes:
        """Encode one NetworkMessage; raises LocalWireError on what cannot be encoded."""
        try:
            if len(message.messages) == 1:
                return self._encode_one(message, message.messages[0])
        except MISFITS:
            pass  # the generic codec says what is wrong
        return encode_message(message)

    def _encode_one(self, message: NetworkMessage, part: DataSetMessage) -> bytes:
        writer: _Writer = message.publisher_id, message.writer_group_id, part.data_set_writer_id
        plan = self._writer_plans.get(writer)
        if plan is not None and plan.fits(message, part):
            return plan.encode_like(part)
        encoded = encode_message(message)
        plan = WriterPlan.for_message(message, part)
        if plan is not None:
            _remember(self._writer_plans, writer, plan, MOST_PLANS)
        return encoded

    def writer_plan(
        self,
        publisher_id: int,
        writer_group_id: int,
        data_set_writer_id: int,
        types: tuple[int, ...],
        major_version: int,
        minor_version: int,
    ) -> WriterPlan:
        """A plan for the key frames of one DataSetWriter (see the package's docstring)."""
        return WriterPlan(publisher_id, writer_group_id, data_set_writer_id, types, major_version, minor_version)


_K = TypeVar("_K")
_V = TypeVar("_V")


def _remember(cache: dict[_K, _V], key: _K, value: _V, most: int) -> None:
    if key not in cache and len(cache) >= most:
        del cache[next(iter(cache))]
    cache[key] = value
