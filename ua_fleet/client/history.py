# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""The history of values, read in pages (OPC 10000-11 6.4)."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from datetime import datetime
from typing import Any, Final

from asyncua import Client, ua

from ua_fleet.client.readings import Reading, reading_of
from ua_fleet.client.translated import NodeNotFound, translated
from ua_fleet.errors import AccessRefused

__all__ = ["AGGREGATES", "HistoryWanted", "read_history"]

AGGREGATES: Final = {
    "interpolated": ua.ObjectIds.AggregateFunction_Interpolative,
    "average": ua.ObjectIds.AggregateFunction_Average,
    "time-average": ua.ObjectIds.AggregateFunction_TimeAverage,
    "minimum": ua.ObjectIds.AggregateFunction_Minimum,
    "maximum": ua.ObjectIds.AggregateFunction_Maximum,
    "count": ua.ObjectIds.AggregateFunction_Count,
    "start": ua.ObjectIds.AggregateFunction_Start,
    "end": ua.ObjectIds.AggregateFunction_End,
    "duration-good": ua.ObjectIds.AggregateFunction_DurationGood,
    "percent-good": ua.ObjectIds.AggregateFunction_PercentGood,
}
"""What can be calculated, by the names of the command line."""


class HistoryWanted:
    """What of a node's history is wanted."""

    def __init__(
        self, since: datetime, until: datetime, *, newest: int = 0, aggregate: str = "", interval_ms: float = 0
    ) -> None:
        """Want values.

        Args:
            since: the time of the first one.
            until: the time before which the last one lies.
            newest: no more than so many, the newest ones first; 0: all, the oldest one first.
            aggregate: one of AGGREGATES, in place of the values themselves.
            interval_ms: of what each aggregate is calculated.
        """
        self.newest = newest
        self._details: Any
        if aggregate:
            function = ua.NodeId(ua.Int32(AGGREGATES[aggregate]))
            configuration = ua.AggregateConfiguration(UseServerCapabilitiesDefaults=True)
            self._details = ua.ReadProcessedDetails(since, until, interval_ms, [function], configuration)
        else:
            start, end = (until, since) if newest else (since, until)
            self._details = ua.ReadRawModifiedDetails(False, start, end, newest, False)

    def request(self, node_id: ua.NodeId, point: bytes | None) -> ua.HistoryReadParameters:
        """The request for a page."""
        parameters = ua.HistoryReadParameters()
        parameters.HistoryReadDetails = self._details
        parameters.TimestampsToReturn = ua.TimestampsToReturn.Source
        parameters.ReleaseContinuationPoints = False
        parameters.NodesToRead = [ua.HistoryReadValueId(node_id, ContinuationPoint=point)]
        return parameters


async def read_history(client: Client, endpoint: str, node_id: str, wanted: HistoryWanted) -> AsyncGenerator[Reading]:
    """The values, page by page.

    Raises:
        AccessRefused: the server keeps no history of this node, or refuses the request.
        NodeNotFound: there is no such node.
        NotConnected: the connection was lost.
    """
    node, point, count = ua.NodeId.from_string(node_id), None, 0
    while True:
        with translated(endpoint):
            [result] = await client.uaclient.history_read(wanted.request(node, point))
        code = 0 if result.StatusCode is None else int(result.StatusCode.value)
        if code == ua.StatusCodes.BadNodeIdUnknown:
            raise NodeNotFound(f"there is no node {node_id}; look with: ua-fleet browse")
        if code == ua.StatusCodes.BadHistoryOperationUnsupported:
            raise AccessRefused(
                code, f"the server keeps no history of {node_id}; add `history` to fleet.yaml (docs/history.md)"
            )
        if code >> 31:
            raise AccessRefused(
                code, f"the server refuses the history of {node_id}: {ua.StatusCode(ua.UInt32(code)).name}"
            )
        data: Any = result.HistoryData
        for value in getattr(data, "DataValues", None) or []:
            yield reading_of(node_id, value)
            count += 1
            if count == wanted.newest:
                return
        point = result.ContinuationPoint
        if not point:
            return
