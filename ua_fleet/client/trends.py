# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""The course of numbers over a span, in few points: what a line begins with.

Raw values where there are no more than asked for, else an Average for each of so many intervals (OPC 10000-11 6.5.3 and
6.5.4).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from math import isfinite
from typing import Any, Final

from asyncua import Client, ua

from ua_fleet.client.translated import translated

__all__ = ["Trend", "read_trends"]

_AVERAGE: Final = ua.NodeId(ua.Int32(ua.ObjectIds.AggregateFunction_Average))
_NODES_AT_ONCE: Final = 50


@dataclass(frozen=True, slots=True)
class Trend:
    """From each time on the number is that value; None: it was not Good, or nobody knows."""

    times: tuple[datetime, ...]
    values: tuple[float | None, ...]
    is_average: bool
    """Whether these are means of intervals, and not the values themselves."""


async def read_trends(
    client: Client, endpoint: str, node_ids: Sequence[str], since: datetime, until: datetime, most: int
) -> dict[str, Trend]:
    """The courses of nodes that have a history; those without one are left out.

    Args:
        client: connected.
        endpoint: of the server, for messages.
        node_ids: the Variables.
        since: the time at which the lines begin; the value that held then is their first one.
        until: the time at which they end.
        most: points of each line at most.

    Raises:
        NotConnected: the connection was lost.
        AccessRefused: the server refuses the request as a whole.
    """
    found: dict[str, Trend] = {}
    for at in range(0, len(node_ids), _NODES_AT_ONCE):
        part = node_ids[at : at + _NODES_AT_ONCE]
        raw = ua.ReadRawModifiedDetails(False, since, until, most, True)
        results = await _read(client, endpoint, raw, part)
        dense = [node for node, result in results.items() if result.ContinuationPoint]
        found |= {
            node: _trend(result, since, until) for node, result in results.items() if not result.ContinuationPoint
        }
        if dense:
            interval_ms = (until - since) / timedelta(milliseconds=1) / most
            configuration = ua.AggregateConfiguration(UseServerCapabilitiesDefaults=True)
            averages = ua.ReadProcessedDetails(since, until, interval_ms, [_AVERAGE] * len(dense), configuration)
            results = await _read(client, endpoint, averages, dense)
            found |= {node: _trend(result, since, until, is_average=True) for node, result in results.items()}
    return found


async def _read(client: Client, endpoint: str, details: Any, node_ids: Sequence[str]) -> Mapping[str, Any]:
    """One HistoryRead; the results of nodes that have a history."""
    parameters = ua.HistoryReadParameters()
    parameters.HistoryReadDetails = details
    parameters.TimestampsToReturn = ua.TimestampsToReturn.Source
    parameters.ReleaseContinuationPoints = False
    parameters.NodesToRead = [ua.HistoryReadValueId(ua.NodeId.from_string(node)) for node in node_ids]
    with translated(endpoint):
        results = await client.uaclient.history_read(parameters)
    return {
        node: result
        for node, result in zip(node_ids, results, strict=True)
        if result.StatusCode is None or not int(result.StatusCode.value) >> 31
    }


def _trend(result: Any, since: datetime, until: datetime, *, is_average: bool = False) -> Trend:
    times: list[datetime] = []
    values: list[float | None] = []
    for data in getattr(result.HistoryData, "DataValues", None) or ():
        told: datetime | None = data.SourceTimestamp
        if told is None:
            continue
        moment = told if told.tzinfo is not None else told.replace(tzinfo=UTC)
        if moment >= until:
            continue  # the bound of the end, which says nothing that holds before it
        times.append(max(moment, since))
        values.append(_number(data))
    return Trend(tuple(times), tuple(values), is_average)


def _number(data: ua.DataValue) -> float | None:
    status = 0 if data.StatusCode is None else int(data.StatusCode.value)
    value: Any = None if data.Value is None else data.Value.Value
    if status >> 30 or isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if isfinite(value) else None
