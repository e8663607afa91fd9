"""Read (OPC 10000-4 5.11.2) from the bytes of a request to those of its response.

What a client asks for again and again are the same few bytes: a NodeId, an attribute, no range and no encoding. These
bytes are the key to what holds the attribute, and its value has its bytes beside it. All else, operation by operation,
is read as ever: scanned, decoded by asyncua, and looked up by `attributes`, which has the rules.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.answers import ArrayResponse
from ua_fleet.endpoint.binary.data_values import kept_bytes, with_times
from ua_fleet.endpoint.binary.operations import OperationReader
from ua_fleet.endpoint.binary.targets import LONGEST_KEY, Access, Targets, node_id_bytes, plain_holders
from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.request import ServiceRequest
from ua_fleet.endpoint.scan import Scan
from ua_fleet.endpoint.stack import DECODE_ERRORS, AttributeIds

__all__ = ["ReadPlan"]

_HEAD: Final = struct.Struct("<dIi")
"""MaxAge, TimestampsToReturn, number of NodesToRead."""
_TIMES: Final = tuple(each for each in ua.TimestampsToReturn if each is not ua.TimestampsToReturn.Invalid)
_AFTER_NODE_ID: Final = 14
"""AttributeId, IndexRange and DataEncoding, where both are empty or null."""
_AT_ONCE: Final = 64
"""Operations between two looks at the clock, which are done in 0.1 ms where nothing has to be looked up."""
_BOTH: Final = ua.TimestampsToReturn.Both
_OF_USERS: Final = frozenset((AttributeIds.UserAccessLevel, AttributeIds.UserExecutable))
"""Attributes that say other things to other users."""

ReadOne = Callable[[ServiceRequest, Any, Any, ArrayResponse], None]
"""Does one operation by the rules, and adds its result."""


class _Target:
    """What one operation reads, as long as the node is there."""

    __slots__ = ("access", "held")

    def __init__(self, held: Any, access: Access | None) -> None:
        self.held = held
        self.access = access
        """Of a value, what let it be read; None of any other attribute."""


class ReadPlan:
    """Reads for all sessions of one server.

    Args:
        context: of the server.
        read_one: does an operation by the rules, and adds its result.
        readable: whether AccessLevel and UserAccessLevel of a node let everybody read its value.
    """

    def __init__(self, context: EndpointContext, read_one: ReadOne, readable: Callable[[ua.NodeId], bool]) -> None:
        self._aspace: Any = context.iserver.aspace
        self._limits, self._read_one, self._readable = context.limits, read_one, readable
        self._operations = OperationReader(ua.ReadValueId, context.limits, _HEAD)
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
        scan, (max_age, times, count) = begun
        if not max_age >= 0 or times >= len(_TIMES):
            return None
        turns = request.turns
        answer = ArrayResponse(ua.ReadResponse, self._limits.response_bytes)
        while count:
            count -= self._some(request, _TIMES[times], scan, answer, min(count, _AT_ONCE))
            if turns.is_due(answer.size):
                await turns.end(answer.size)
        return answer

    def _some(self, request: ServiceRequest, times: Any, scan: Scan, answer: ArrayResponse, count: int) -> int:
        """Do so many operations, or those until it is another's turn; how many were done."""
        data, targets, position = scan.data, self._targets.known(), scan.position
        for number in range(count):
            end = position + node_id_bytes(data, position) + _AFTER_NODE_ID
            target = targets.get(data[position:end])
            if target is not None and _add(target, times, answer):
                position = end
                continue
            scan.position, scan.share = position, scan.memory
            scan.charge_built(self._operations.step.memory)
            wanted = self._operations.whole(scan)
            if scan.position == end <= position + LONGEST_KEY and target is None:
                self._remember(data[position:end], wanted)
            position = scan.position
            self._read_one(request, wanted, times, answer)
            if request.turns.is_due(answer.size):
                scan.position = position
                return number + 1
        scan.position = position
        return count

    def _remember(self, key: bytes, wanted: Any) -> None:
        """Know next time what holds the attribute, if it says the same to all users."""
        node = self._aspace.get(wanted.NodeId)
        if node is None or wanted.AttributeId in _OF_USERS:
            return
        holders = plain_holders(node, wanted.AttributeId)
        if holders is None or (wanted.AttributeId == AttributeIds.Value and not self._readable(wanted.NodeId)):
            return
        held, *access = holders
        if not isinstance(held, HeldValue):
            held.encoded = None  # as ours have it
        self._targets.known()[key] = _Target(held, Access(*access) if access else None)


def _add(target: _Target, times: Any, answer: ArrayResponse) -> bool:
    """Add the bytes of a value; False where the rules have to be asked."""
    held = target.held
    value = held.value
    kept = held.encoded
    if kept is not None and kept[0] is value:
        data = kept[1]
    else:
        if value is None or held.value_callback is not None:
            return False
        try:
            data = kept_bytes(held, value)
        except DECODE_ERRORS:
            return False
        if data is None:
            return False
    access = target.access
    if access is not None and (  # as `is_as_it_was` has it: each value of each Read comes by here
        access.level.value is not access.level_value or access.user_level.value is not access.user_level_value
    ):
        return False
    if times is not _BOTH:
        data = with_times(data, times)
    if len(data) > answer.left:
        return False
    answer.add_bytes(data)
    return True
