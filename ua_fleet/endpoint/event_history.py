"""HistoryRead of events (OPC 10000-11 6.5.2): those that the Server object has told, chosen by an EventFilter."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import struct
from functools import cached_property
from typing import Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.binary.builtin import encode_variant
from ua_fleet.endpoint.binary.encoders import encode
from ua_fleet.endpoint.context import EndpointContext
from ua_fleet.endpoint.convert import ticks_of
from ua_fleet.endpoint.event_fields import EventField, EventFields
from ua_fleet.endpoint.filters import EventFilter, check_event_filter
from ua_fleet.endpoint.history_source import MOST_EVENTS, HistorySource
from ua_fleet.endpoint.kept_events import PastEvent, past_event
from ua_fleet.endpoint.node_builder import HISTORY_READ
from ua_fleet.endpoint.stack import DECODE_ERRORS, AttributeIds, Refusal, StatusCodes, status
from ua_fleet.endpoint.users import Role, User
from ua_fleet.errors import StorageUnavailable
from ua_fleet.history.events import BrokenEvent, EventPage, EventPosition, first_position, read_events
from ua_fleet.history.raw import RawRead
from ua_fleet.history.rows import Row, Series

__all__ = ["HISTORY_EVENT", "EventHistory", "EventRequest"]

HISTORY_EVENT: Final = 661
"""NodeId of the binary encoding of HistoryEvent."""
_STEPS: Final = 100_000
"""Of a filter for one request, of some microseconds each: a page of a filter that few events pass ends after them, and
so do the pages of a request that names its node ten thousand times."""
_ROW_STEPS: Final = 10
"""Of a row, whatever the filter."""
_LOOK_STEPS: Final = 2_000
"""Of a look into the store at least: it reads some hundred rows."""
_NULL: Final = b"\x00"
_BROKEN: Final = (*DECODE_ERRORS, struct.error, ValueError)


class EventHistory:
    """Reads events of the past."""

    def __init__(self, context: EndpointContext) -> None:
        self._context = context
        self._declared = EventFields(context.iserver.aspace)

    def request(self, user: User, details: ua.ReadEventDetails) -> EventRequest:
        """Begin a request.

        Args:
            user: who asks. AuditEvents are for engineers.
            details: which events, of each node.
        """
        return EventRequest(self._context, self._declared, user, details)


class EventRequest:
    """One request. Its operations share the filter, which is checked once, and the steps that are left."""

    def __init__(
        self, context: EndpointContext, declared: EventFields, user: User, details: ua.ReadEventDetails
    ) -> None:
        self._context, self._declared, self._user, self._details = context, declared, user, details
        self._aspace: AddressSpace = context.iserver.aspace
        self._steps = _STEPS

    @cached_property
    def _filter(self) -> tuple[EventFilter, bytes] | str:
        """The filter, and its bytes; or why it is refused."""
        wanted = self._details.Filter
        if not isinstance(wanted, ua.EventFilter) or not wanted.SelectClauses:
            return "it selects no field"
        try:
            chosen = check_event_filter(self._aspace, wanted, self._context.limits.filter_elements, self._declared)
        except Refusal as error:
            return str(error)
        return chosen, encode(wanted)

    async def read(self, node: ua.HistoryReadValueId, *, room: int, whole: int) -> tuple[bytes, int, bytes]:
        """HistoryEvent, the number of its events, and the continuation point; raises Refusal.

        Args:
            node: a notifier.
            room: bytes that they may take.
            whole: bytes that they might take in an answer of their own.
        """
        history = self._history_of(node.NodeId)
        if node.IndexRange:
            raise Refusal(StatusCodes.BadHistoryOperationUnsupported)
        if isinstance(self._filter, str):
            raise Refusal(StatusCodes.BadEventFilterInvalid, self._filter)
        chosen, filter_data = self._filter
        points, name = history.continuations, node.NodeId.to_string()
        read, at = _read_of(self._details), None
        if node.ContinuationPoint:
            found = points.read_events(name, filter_data, bytes(node.ContinuationPoint))
            if found is None:
                raise Refusal(StatusCodes.BadContinuationPointInvalid)
            read, at = found
        elif not read.is_valid:
            raise Refusal(StatusCodes.BadHistoryOperationInvalid)

        cost = _ROW_STEPS + chosen.cost
        most_rows = self._steps // cost

        def look(series: Series) -> EventPage:
            return _page(series, read, at, chosen, room=room - 4, whole=whole - 4, most_rows=most_rows)

        if most_rows > 0:
            page = await history.look_at_events(look, audit=self._user.role.covers(Role.ENGINEER))
            self._steps -= max(page.looked * cost, _LOOK_STEPS)
            for reason in page.broken:
                self._context.mistakes.caught("history", StorageUnavailable(reason))
        else:
            page = EventPage([], at or first_position(read), 0)
        data = len(page.events).to_bytes(4, "little") + b"".join(page.events)
        point = b"" if page.rest is None else points.of_events(name, read, filter_data, page.rest)
        return data, len(page.events), point

    def _history_of(self, node_id: ua.NodeId) -> HistorySource:
        """Where the events of a notifier are; raises Refusal."""
        if self._aspace.get(node_id) is None:
            raise Refusal(StatusCodes.BadNodeIdUnknown)
        notifier = self._aspace.read_attribute_value(node_id, AttributeIds.EventNotifier).Value
        history = self._context.history
        if history is None or not history.has_events or not _may_read(notifier):
            raise Refusal(StatusCodes.BadHistoryOperationUnsupported)
        return history


def _page(
    series: Series,
    read: RawRead,
    at: EventPosition | None,
    wanted: EventFilter,
    *,
    room: int,
    whole: int,
    most_rows: int,
) -> EventPage:
    def chosen(row: Row) -> bytes | None:
        try:
            event = past_event(row)
            return _fields(event, wanted.select, whole) if wanted.passes(event) else None
        except _BROKEN as error:
            raise BrokenEvent(f"{type(error).__name__}: {error!s:.100}") from error

    return read_events(series, read, at, chosen, most=MOST_EVENTS, room=room, most_rows=most_rows)


def _may_read(notifier: ua.Variant | None) -> bool:
    """Whether an EventNotifier, which only Objects and Views have, says HistoryRead."""
    return notifier is not None and bool((notifier.Value or 0) & HISTORY_READ)


def _read_of(details: ua.ReadEventDetails) -> RawRead:
    start, end = ticks_of(details.StartTime), ticks_of(details.EndTime)
    return RawRead(start or None, end or None, int(details.NumValuesPerNode), bounds=False)


def _fields(event: PastEvent, select: list[EventField], whole: int) -> bytes:
    """A HistoryEventFieldList (OPC 10000-11 6.6.4). One that no answer has room for has StatusCodes as fields."""
    parts = [_field(event, field) for field in select]
    size = len(parts).to_bytes(4, "little")
    if 4 + sum(map(len, parts)) > whole:
        too_large = status(StatusCodes.BadEncodingLimitsExceeded)
        parts = [encode_variant(ua.Variant(too_large, ua.VariantType.StatusCode))] * len(parts)
    return b"".join((size, *parts))


def _field(event: PastEvent, field: EventField) -> bytes:
    if field.index_range is None:
        return event.encoded(field.name) or _NULL
    return encode_variant(field.of(event))
