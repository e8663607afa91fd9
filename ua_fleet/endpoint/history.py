"""HistoryRead (OPC 10000-4 5.11.3, OPC 10000-11 6.4): raw values, values at times, aggregates; events: `event_history`.

What is read is computed where the store is, outside of the event loop, and comes back as bytes.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import Any, Final, NamedTuple, TypeVar

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.answers import ArrayResponse
from ua_fleet.endpoint.attributes import access_level
from ua_fleet.endpoint.binary.encoders import NO_OBJECT
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.convert import ticks_of
from ua_fleet.endpoint.event_history import HISTORY_EVENT, EventHistory, EventRequest
from ua_fleet.endpoint.history_source import MOST_RETURNED, HistorySource
from ua_fleet.endpoint.live import check_reader
from ua_fleet.endpoint.node_builder import HISTORY_READ
from ua_fleet.endpoint.request import ServiceRequest, operations
from ua_fleet.endpoint.stack import AttributeIds, Refusal, StatusCodes, shown
from ua_fleet.errors import StorageAway, StorageUnavailable
from ua_fleet.history.aggregates import Aggregate
from ua_fleet.history.at_times import TooMuch, read_at_times
from ua_fleet.history.blocks import HISTORY_DATA, encode_rows
from ua_fleet.history.bounds import Settings
from ua_fleet.history.processed import Failure, ProcessedRead, read_processed
from ua_fleet.history.raw import Phase, Position, RawRead, read_raw
from ua_fleet.history.rows import LATEST, Series
from ua_fleet.history.store import node_text
from ua_fleet.values import NodeId

__all__ = ["HistoryServices", "refused"]

MOST_TIMES: Final = 1_000
"""Of one ReadAtTime: it has no continuation point, since that would have to hold them."""
_RESULT_BYTES: Final = 4 + 4 + 128 + 4 + 1 + 4
"""Of a HistoryReadResult around its values, with the largest continuation point."""
_DATA_TYPE: Final = b"\x01\x00" + HISTORY_DATA.to_bytes(2, "little") + b"\x01"
_EVENT_TYPE: Final = b"\x01\x00" + HISTORY_EVENT.to_bytes(2, "little") + b"\x01"
_OTHER_EVENTS: Final = (ua.ReadEventDetails2, ua.ReadEventDetailsSorted)
"""ReadEvent as it was in 1.04 is what there is."""
_NOTHING: Final = b"\xff\xff\xff\xff" + NO_OBJECT
"""No ContinuationPoint, and no HistoryData."""
_Said = TypeVar("_Said")


class _Data(NamedTuple):
    """The values of a result, and where the rest is."""

    data: bytes
    number: int
    point: bytes = b""


class _Wanted(NamedTuple):
    """One operation of a request."""

    key: NodeId
    name: str
    stepped: bool
    point: bytes
    room: int
    """Bytes that its values may take."""
    whole: int
    """Bytes that they might take in an answer of their own."""


class HistoryServices:
    """HistoryRead. Its limits are those of the endpoint, and `MOST_RETURNED`."""

    def __init__(self, context: EndpointContext) -> None:
        self._context, self._limits = context, context.limits
        self._aspace: AddressSpace = context.iserver.aspace
        self._events = EventHistory(context)

    async def history_read(self, request: ServiceRequest, params: ua.HistoryReadParameters) -> Any:
        """HistoryRead of nodes that have and show a history."""
        nodes = operations(params.NodesToRead, self._limits.nodes_per_request)
        details, wanted = params.HistoryReadDetails, params.TimestampsToReturn
        return await self.read(request, details, wanted, nodes, releases=bool(params.ReleaseContinuationPoints))

    async def read(
        self, request: ServiceRequest, details: Any, wanted: Any, nodes: Sequence[Any], *, releases: bool
    ) -> ArrayResponse:
        """HistoryRead.

        Args:
            request: whose it is.
            details: HistoryReadDetails.
            wanted: TimestampsToReturn, or the number of none.
            nodes: HistoryReadValueIds.
            releases: whether continuation points are given back, and nothing is read.

        Raises:
            Refusal: it is refused as a whole, or not to go on.
        """
        of_events = isinstance(details, ua.ReadEventDetails) and not isinstance(details, _OTHER_EVENTS)
        known = isinstance(wanted, ua.TimestampsToReturn)
        if not of_events and (not known or wanted in (ua.TimestampsToReturn.Invalid, ua.TimestampsToReturn.Neither)):
            raise Refusal(StatusCodes.BadTimestampsToReturnInvalid)
        whole = request.session.room_for_one(self._limits.response_bytes)
        answer = ArrayResponse(ua.HistoryReadResponse, whole)
        events = self._events.request(request.user, details) if of_events else None
        is_away = False
        for number, node in enumerate(nodes):
            if releases:
                answer.add_small(refused(0))  # nothing is kept for them
                continue
            code = 0
            try:
                if is_away:  # each try may wait for the network
                    code = StatusCodes.BadDataUnavailable
                elif events is not None:
                    answer.add_bytes(await _event_result(events, node, answer.left, whole))
                else:
                    operation = self._wanted(request, node, answer.left, whole)
                    answer.add_bytes(_result(await self._read_of(details, number, nodes, wanted)(operation)))
            except Refusal as error:
                code = error.ua_status
            except StorageUnavailable as error:
                code = StatusCodes.BadDataUnavailable  # the log says why
                is_away = isinstance(error, StorageAway)
            except Exception as error:  # noqa: BLE001 - a mistake about one node must not cost the client the others
                self._context.mistakes.caught("history", error, node=shown(node.NodeId))
                code = StatusCodes.BadInternalError
            if code:
                answer.add_small(refused(code))
            await request.turns.end(answer.size)
        return answer

    def _wanted(self, request: ServiceRequest, node: ua.HistoryReadValueId, room: int, whole: int) -> _Wanted:
        """An operation that the user may do; raises Refusal.

        Args:
            request: whose it is.
            node: of it.
            room: bytes that are left in the answer.
            whole: bytes that an answer has.
        """
        node_id = node.NodeId
        if self._aspace.get(node_id) is None:
            raise Refusal(StatusCodes.BadNodeIdUnknown)
        check_reader(self._aspace, node_id, AttributeIds.Value, request.user, encrypted=request.encrypted)
        history, identifier = self._context.history, node_id.Identifier
        stepped: bool | None = None
        key = NodeId(int(node_id.NamespaceIndex), identifier if isinstance(identifier, str) else _number(identifier))
        if history is not None and access_level(self._aspace, node_id) & HISTORY_READ:
            stepped = history.is_stepped(key)
        if stepped is None:
            raise Refusal(StatusCodes.BadHistoryOperationUnsupported)
        if node.IndexRange:
            raise Refusal(StatusCodes.BadHistoryOperationUnsupported)
        _check_room(node, room)
        point = bytes(node.ContinuationPoint or b"")
        return _Wanted(key, node_text(key), stepped, point, room - _RESULT_BYTES, whole - _RESULT_BYTES)

    def _read_of(self, details: Any, number: int, nodes: Any, timestamps: Any) -> Callable[[_Wanted], Awaitable[_Data]]:
        """What does one operation; raises Refusal."""
        if isinstance(details, ua.ReadRawModifiedDetails) and not details.IsReadModified:
            read = partial(self._raw, details=details)
        elif isinstance(details, ua.ReadAtTimeDetails):
            read = partial(self._at_times, details=details)
        elif isinstance(details, ua.ReadProcessedDetails):
            kinds = details.AggregateType or []
            if len(kinds) != len(nodes):
                raise Refusal(StatusCodes.BadAggregateListMismatch)
            read = partial(self._processed, details=details, kind=kinds[number])
        else:
            raise Refusal(StatusCodes.BadHistoryOperationUnsupported)
        if timestamps == ua.TimestampsToReturn.Server:
            raise Refusal(StatusCodes.BadTimestampNotSupported)
        return read

    @property
    def _history(self) -> HistorySource:
        assert self._context.history is not None
        return self._context.history

    async def _raw(self, wanted: _Wanted, details: ua.ReadRawModifiedDetails) -> _Data:
        points = self._history.continuations
        at: Position | None = None
        if wanted.point:
            read, at = _known(points.read_raw(wanted.name, wanted.point))
        else:
            start, end = ticks_of(details.StartTime), ticks_of(details.EndTime)
            read = RawRead(start or None, end or None, int(details.NumValuesPerNode), bool(details.ReturnBounds))
            if not read.is_valid:
                raise Refusal(StatusCodes.BadHistoryOperationInvalid)

        def look(series: Series) -> _Data:
            page = read_raw(series, read, at, MOST_RETURNED)
            data, count = encode_rows(page.rows, wanted.room, wanted.whole)
            rest = page.rest
            if count < len(page.rows):
                row = page.rows[count]
                is_end_bound = page.rest is None and count == len(page.rows) - 1 and read.bounds
                rest = Position(Phase.END_BOUND, 0) if row is None or is_end_bound else Position(Phase.WITHIN, row.time)
                if not count:  # what comes before in this answer has left no room: all of it is in the next one
                    rest = Position(Phase.BEGIN, read.begin) if at is None else at
            return _Data(data, count, b"" if rest is None else points.of_raw(wanted.name, read, rest))

        return await self._history.look(wanted.key, look)

    async def _at_times(self, wanted: _Wanted, details: ua.ReadAtTimeDetails) -> _Data:
        if wanted.point:
            raise Refusal(StatusCodes.BadContinuationPointInvalid)
        times = [ticks_of(time) for time in details.ReqTimes or []]
        if not times:
            raise Refusal(StatusCodes.BadNothingToDo)
        if len(times) > MOST_TIMES:
            raise Refusal(StatusCodes.BadTooManyOperations)
        settings, simple = Settings(stepped=wanted.stepped), bool(details.UseSimpleBounds)

        def look(series: Series) -> _Data:
            rows = read_at_times(series, times, settings, simple=simple)
            try:
                data, count = encode_rows(rows, wanted.room, wanted.whole)
            except TooMuch:
                raise Refusal(StatusCodes.BadQueryTooComplex) from None
            if count < len(times):
                raise Refusal(StatusCodes.BadEncodingLimitsExceeded)
            return _Data(data, count)

        return await self._history.look(wanted.key, look)

    async def _processed(self, wanted: _Wanted, details: ua.ReadProcessedDetails, kind: Any) -> _Data:
        points, number = self._history.continuations, 0
        if wanted.point:
            read, number = _known(points.read_processed(wanted.name, wanted.point))
        else:
            read = _processed_read(details, kind, stepped=wanted.stepped)

        def look(series: Series) -> _Data:
            page = read_processed(series, read, number, MOST_RETURNED)
            if isinstance(page, Failure):
                too_much, invalid = StatusCodes.BadQueryTooComplex, StatusCodes.BadAggregateInvalidInputs
                raise Refusal(too_much if page.is_too_much else invalid)
            data, count = encode_rows(page.rows, wanted.room, wanted.whole)
            rest = number + count if count < len(page.rows) else page.rest
            return _Data(data, count, b"" if rest is None else points.of_processed(wanted.name, read, rest))

        return await self._history.look(wanted.key, look)


async def _event_result(events: EventRequest, node: ua.HistoryReadValueId, room: int, whole: int) -> bytes:
    """The result of a ReadEvents; raises Refusal."""
    _check_room(node, room)
    data = await events.read(node, room=room - _RESULT_BYTES, whole=whole - _RESULT_BYTES)
    return _result(_Data(*data), _EVENT_TYPE)


def _check_room(node: ua.HistoryReadValueId, room: int) -> None:
    """Raise Refusal where a result has another encoding than ours, or no room."""
    if node.DataEncoding is not None and node.DataEncoding.Name:
        raise Refusal(StatusCodes.BadDataEncodingInvalid)
    if room <= _RESULT_BYTES:
        raise Refusal(StatusCodes.BadEncodingLimitsExceeded)


def _known(said: _Said | None) -> _Said:
    """What a continuation point says; raises Refusal for one that is none of ours."""
    if said is None:
        raise Refusal(StatusCodes.BadContinuationPointInvalid)
    return said


def _processed_read(details: ua.ReadProcessedDetails, kind: Any, *, stepped: bool) -> ProcessedRead:
    """What a request wants; raises Refusal."""
    start, end, interval_ms = ticks_of(details.StartTime), ticks_of(details.EndTime), float(details.ProcessingInterval)
    if not start or not end or start == end or not 0 <= interval_ms < LATEST:
        raise Refusal(StatusCodes.BadInvalidArgument)
    known = kind.NamespaceIndex == 0 and isinstance(kind.Identifier, int) and kind.Identifier in set(Aggregate)
    if not known:
        raise Refusal(StatusCodes.BadAggregateNotSupported)
    said = details.AggregateConfiguration
    settings = Settings(stepped=stepped)
    if said is not None and not said.UseServerCapabilitiesDefaults:
        settings = Settings(
            stepped,
            bool(said.TreatUncertainAsBad),
            int(said.PercentDataBad),
            int(said.PercentDataGood),
            bool(said.UseSlopedExtrapolation),
        )
        if not settings.is_valid:
            raise Refusal(StatusCodes.BadAggregateInvalidInputs)
    read = ProcessedRead(start, end, interval_ms, Aggregate(kind.Identifier), settings)
    if read.count > 0xFFFF_FFFF:
        raise Refusal(StatusCodes.BadInvalidArgument)
    return read


def _number(identifier: Any) -> int:
    """A numeric identifier; -1 for a Guid or bytes, which no node of a fleet has."""
    return int(identifier) if isinstance(identifier, int) else -1


def refused(code: int) -> bytes:
    """A HistoryReadResult of a StatusCode alone."""
    return code.to_bytes(4, "little") + _NOTHING


def _result(data: _Data, data_type: bytes = _DATA_TYPE) -> bytes:
    """A HistoryReadResult with HistoryData, or HistoryEvent (OPC 10000-4 5.11.3.2)."""
    code = 0 if data.number or data.point else int(StatusCodes.GoodNoData)
    length = (len(data.point) or -1).to_bytes(4, "little", signed=True)
    size = len(data.data).to_bytes(4, "little")
    return b"".join((code.to_bytes(4, "little"), length, data.point, data_type, size, data.data))
