"""Write (OPC 10000-4 5.11.4) from the bytes of a request.

The first bytes of an operation, a NodeId and the attribute Value without a range, are the key to what holds the value;
a number or a text behind them is decoded in one pass. All else is scanned and decoded by asyncua. The whole request is
decoded before the first value is written: of one that is no valid encoding nothing is. `writes` has the rules.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import struct
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.answers import ArrayResponse
from ua_fleet.endpoint.binary.decoders import decode_plain_value
from ua_fleet.endpoint.binary.operations import OperationReader
from ua_fleet.endpoint.binary.targets import LONGEST_KEY, Access, Targets, node_id_bytes, plain_holders
from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.request import ServiceRequest
from ua_fleet.endpoint.scan import Scan
from ua_fleet.endpoint.stack import AttributeIds, shown
from ua_fleet.endpoint.writes import Writes, WriteServices

__all__ = ["WritePlan"]

_VALUE: Final = AttributeIds.Value
_WHOLE_VALUE: Final = struct.pack("<I", _VALUE) + b"\xff\xff\xff\xff"
"""AttributeId and IndexRange of a whole value."""
_AFTER_NODE_ID: Final = len(_WHOLE_VALUE)


class _Target:
    """A value that may be written, as long as the node is there."""

    __slots__ = ("_is_ours", "access", "held", "node_id", "text")

    def __init__(self, node_id: ua.NodeId, held: Any, access: Access) -> None:
        self.node_id, self.text = node_id, shown(node_id)
        self.held, self.access = held, access
        self._is_ours = isinstance(held, HeldValue)

    def takes(self, given: Any) -> bool:
        """Whether a value only has to be put in place of the one there; else what has to be done is asyncua's."""
        held = self.held
        value = held.value
        return (
            self.access.is_as_it_was
            and not (held.is_watched if self._is_ours else held.datachange_callbacks)
            and held.value_setter is None
            and held.value_callback is None
            and value is not None
            and value.Value is not None
            and value.Value.VariantType is given.Value.VariantType
        )


_Operation = tuple[_Target | None, Any]
"""A target with the DataValue for it, or None with a WriteValue."""


class WritePlan:
    """Writes for all sessions of one server."""

    def __init__(self, context: EndpointContext, services: WriteServices) -> None:
        self._aspace: Any = context.iserver.aspace
        self._services = services
        self._operations = OperationReader(ua.WriteValue, context.limits)
        self._targets = Targets[_Target](context.iserver.aspace)

    async def serve(self, request: ServiceRequest, data: bytes, start: int) -> ArrayResponse | None:
        """The response; None for a request that is refused as a whole, which is left to those who know why.

        Args:
            request: whose it is.
            data: the whole request.
            start: where its parameters begin.

        Raises:
            Refusal: an operation is no valid encoding, or the request is not to go on.
        """
        begun = self._operations.begin(data, start)
        if begun is None:
            return None
        scan, (count,) = begun
        turns = request.turns
        removed = self._targets.removed
        decoded = await self._operations.all(scan, count, turns, self._decoded)
        with self._services.begin(request) as writes:
            for target, given in decoded:
                await self._do(writes, target, given, is_known=removed == self._targets.removed)
                if turns.over:
                    await writes.end_turn()
        return writes.answer

    def _decoded(self, scan: Scan) -> _Operation:
        """The next operation."""
        data, position = scan.data, scan.position
        end = position + node_id_bytes(data, position) + _AFTER_NODE_ID
        target = self._targets.known().get(data[position:end])
        given = None if target is None else self._operations.rest(scan, end, decode_plain_value)
        if given is not None:
            return target, given
        wanted = self._operations.whole(scan)
        if target is None and end <= position + LONGEST_KEY and data[end - _AFTER_NODE_ID : end] == _WHOLE_VALUE:
            self._remember(data[position:end], wanted.NodeId)
        return None, wanted

    def _remember(self, key: bytes, node_id: ua.NodeId) -> None:
        """Know next time what holds the value, if it may be written."""
        node = self._aspace.get(node_id)
        holders = plain_holders(node, _VALUE) if node is not None and self._services.is_writable(node_id) else None
        if holders is not None:
            held, *access = holders
            self._targets.known()[key] = _Target(node_id, held, Access(*access))

    async def _do(self, writes: Writes, target: _Target | None, given: Any, *, is_known: bool) -> None:
        """Do one operation; what was known of it may be wrong where a node has gone since."""
        if target is None:
            await writes.one(given)
        elif is_known and not writes.told and target.takes(given):
            writes.value(target.node_id, target.text, target.held, given)
        else:
            whole: Any = None
            await writes.one(ua.WriteValue(target.node_id, _VALUE, whole, given))
