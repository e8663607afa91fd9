"""HistoryRead (OPC 10000-4 5.11.3) from the bytes of a request; `history` has the rules, and its results are bytes.

What all nodes are read by has one of three forms, or is decoded by asyncua: events, whose filters are long, and what
nobody may read so.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import struct
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.answers import ArrayResponse
from ua_fleet.endpoint.binary.history_details import decode_history_details
from ua_fleet.endpoint.binary.operations import OperationReader
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.history import HistoryServices
from ua_fleet.endpoint.request import ServiceRequest
from ua_fleet.endpoint.scan import steps_of

__all__ = ["HistoryReadPlan"]

_BEFORE_NODES: Final = struct.Struct("<I?i")
"""TimestampsToReturn, ReleaseContinuationPoints, number of NodesToRead."""
_TIMES: Final[dict[int, Any]] = {int(each): each for each in ua.TimestampsToReturn}
_AROUND: Final = sum(part.step.memory for part in steps_of(ua.HistoryReadParameters) if not part.is_array)


class HistoryReadPlan:
    """Reads of the history for all sessions of one server."""

    def __init__(self, context: EndpointContext, history: HistoryServices) -> None:
        self._operations = OperationReader(ua.HistoryReadValueId, context.limits, _BEFORE_NODES, around=_AROUND)
        self._history = history

    async def serve(self, request: ServiceRequest, data: bytes, start: int) -> ArrayResponse | None:
        """The response; None for a request of another form, or that is refused as a whole.

        Args:
            request: whose it is.
            data: the whole request.
            start: where its parameters begin.

        Raises:
            Refusal: an operation is no valid encoding, or the request is not to go on.
        """
        plain = decode_history_details(data, start)
        if plain is None:
            return None
        details, end, memory = plain
        begun = self._operations.begin(data, end, beside=memory)
        if begun is None:
            return None
        scan, (times, releases, count) = begun
        nodes = await self._operations.all(scan, count, request.turns, self._operations.whole)
        return await self._history.read(request, details, _TIMES.get(times, times), nodes, releases=releases)
