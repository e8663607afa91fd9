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
from asyncua.common.utils import Buffer
from asyncua.server.address_space import AttributeValue

from ua_fleet.endpoint.answers import ArrayResponse
from ua_fleet.endpoint.binary.data_values import kept_bytes, with_times
from ua_fleet.endpoint.compact_nodes import HeldValue, Shared
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.decoding import decode_operation
from ua_fleet.endpoint.request import ServiceRequest
from ua_fleet.endpoint.scan import Scan, step_of
from ua_fleet.endpoint.stack import DECODE_ERRORS, AttributeIds
from ua_fleet.endpoint.turns import LARGE_BYTES, Turns

__all__ = ["ReadPlan"]

_HEAD: Final = struct.Struct("<dIi")
"""MaxAge, TimestampsToReturn, number of NodesToRead."""
_STEP: Final = step_of(ua.ReadValueId)
_TIMES: Final = tuple(each for each in ua.TimestampsToReturn if each is not ua.TimestampsToReturn.Invalid)
_AFTER_NODE_ID: Final = 14
"""AttributeId, IndexRange and DataEncoding, where both are empty or null."""
_LONGEST_KEY: Final = 256
_MOST_TARGETS: Final = 65_536
_AT_ONCE: Final = 64
"""Operations between two looks at the clock, which are done in 0.1 ms where nothing has to be looked up."""
_ACCESS: Final = (AttributeIds.AccessLevel, AttributeIds.UserAccessLevel)
_BOTH: Final = ua.TimestampsToReturn.Both
_STRING: Final = 3
"""Encoding byte of a NodeId with a String."""
_NODE_ID_BYTES: Final = {0: 2, 1: 4, 2: 7, 4: 19}
"""Of NodeIds by their encoding byte (OPC 10000-6 5.2.2.9)."""
_PLAIN: Final = (HeldValue, Shared, AttributeValue)
"""Of others, the value is computed when it is read, and not for everybody."""
_OF_USERS: Final = frozenset((AttributeIds.UserAccessLevel, AttributeIds.UserExecutable))
"""Attributes that say other things to other users."""

ReadOne = Callable[[ServiceRequest, Any, Any, ArrayResponse], None]
"""Does one operation by the rules, and adds its result."""


class _Target:
    """What one operation reads, as long as the node is there."""

    __slots__ = ("access", "access_value", "held", "user_access", "user_access_value")

    def __init__(self, held: Any, access: Any = None, user_access: Any = None) -> None:
        self.held = held
        self.access, self.user_access = access, user_access
        """Of a value, what let it be read; None of any other attribute."""
        self.access_value = self.user_access_value = None
        if access is not None:
            self.access_value, self.user_access_value = access.value, user_access.value


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
        self._targets: dict[bytes, _Target] = {}
        self._removed = -1

    async def serve(self, request: ServiceRequest, data: bytes, start: int) -> ArrayResponse | None:
        """The response; None for a request that is refused as a whole, which is left to those who know why.

        Args:
            request: whose it is.
            data: the whole request.
            start: where its parameters begin.

        Raises:
            Refusal: an operation is no valid encoding, or the request is not to go on.
        """
        if len(data) - start < _HEAD.size:
            return None
        max_age, times, count = _HEAD.unpack_from(data, start)
        limits, turns = self._limits, request.turns
        scan = Scan(data, start + _HEAD.size, len(data), limits.request_memory_bytes)
        if not (
            max_age >= 0
            and times < len(_TIMES)
            and 0 < count <= limits.nodes_per_request
            and count * _STEP.least <= len(data) - scan.position
            and count * _STEP.memory <= scan.memory
        ):
            return None
        answer = ArrayResponse(ua.ReadResponse(), limits.response_bytes)
        while count:
            count -= self._some(request, _TIMES[times], scan, answer, min(count, _AT_ONCE))
            if _is_over(turns, answer):
                await turns.end(answer.size)
        return answer

    def _some(self, request: ServiceRequest, times: Any, scan: Scan, answer: ArrayResponse, count: int) -> int:
        """Do so many operations, or those until it is another's turn; how many were done."""
        data, targets, position = scan.data, self._known(), scan.position
        for number in range(count):
            end = position + _size(data, position)
            target = targets.get(data[position:end])
            if target is not None and _add(target, times, answer):
                position = end
                continue
            scan.position, scan.share = position, scan.memory
            scan.charge_built(_STEP.memory)
            wanted = decode_operation(ua.ReadValueId, _STEP.walk, scan, Buffer(data, position))
            if scan.position == end <= position + _LONGEST_KEY and target is None:
                self._remember(data[position:end], wanted)
            position = scan.position
            self._read_one(request, wanted, times, answer)
            if _is_over(request.turns, answer):
                scan.position = position
                return number + 1
        scan.position = position
        return count

    def _known(self) -> dict[bytes, _Target]:
        """The targets, none of which belongs to a node that has gone."""
        removed = self._aspace._nodes.removed  # noqa: SLF001 - it has no accessor
        if removed != self._removed or len(self._targets) >= _MOST_TARGETS:
            self._targets.clear()
            self._removed = removed
        return self._targets

    def _remember(self, key: bytes, wanted: Any) -> None:
        """Know next time what holds the attribute, if it says the same to all users."""
        node = self._aspace.get(wanted.NodeId)
        if node is None or wanted.AttributeId in _OF_USERS:
            return
        attributes: tuple[Any, ...] = (wanted.AttributeId,)
        if wanted.AttributeId == AttributeIds.Value:
            if not self._readable(wanted.NodeId):
                return
            attributes += _ACCESS
        holders: list[Any] = [node.attributes.get(each) for each in attributes]
        held: Any = holders[0]
        if any(type(each) not in _PLAIN or each.value_callback is not None for each in holders):
            return
        if not isinstance(held, HeldValue):
            held.encoded = None  # as ours have it
        self._targets[key] = _Target(*holders)


def _is_over(turns: Turns, answer: ArrayResponse) -> bool:
    return turns.over or (answer.size > LARGE_BYTES and not turns.is_large)


def _size(data: bytes, position: int) -> int:
    """Bytes of a plain operation that begins there; of any other one, whatever comes out."""
    kind = data[position] if position < len(data) else 0
    if kind == _STRING:
        return 7 + int.from_bytes(data[position + 3 : position + 7], "little") + _AFTER_NODE_ID
    return _NODE_ID_BYTES.get(kind, 0) + _AFTER_NODE_ID


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
    if target.access is not None and (
        target.access.value is not target.access_value or target.user_access.value is not target.user_access_value
    ):
        return False
    if times is not _BOTH:
        data = with_times(data, times)
    if len(data) > answer.left:
        return False
    answer.add_bytes(data)
    return True
