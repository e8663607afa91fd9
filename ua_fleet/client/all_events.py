# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Everything that a server tells of as an event, whatever its type, with the fields that most types have: as it
happens, and of the past (OPC 10000-11 6.5.2).
"""

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Mapping, Sequence
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

from asyncua import Client, ua
from asyncua.common.subscription import Subscription

from ua_fleet.client.batches import Batches
from ua_fleet.client.convert import plain_value
from ua_fleet.client.subscriptions import Feed, Subscriptions
from ua_fleet.client.translated import translated
from ua_fleet.errors import AccessRefused, NotConnected
from ua_fleet.topics import TYPES_URI

__all__ = ["EventInfo", "all_events", "past_events"]

_BASE: Final = ("EventId", "EventType", "SourceNode", "SourceName", "Time", "Message", "Severity")
_AUDIT: Final = ("ClientUserId", "Status", "StatusCodeId")
_CONDITION: Final = (
    *("ConditionName", "EnabledState", "ActiveState", "AckedState", "ConfirmedState", "SuppressedState"),
    *("ShelvingState/CurrentState", "LimitState/CurrentState", "Comment"),
)
_OWN: Final = ("Robot", "Skill", "RunId", "Task", "Reason")
"""Fields of ours that some types have."""
_QUEUE: Final = 10_000
_SERVER: Final = ua.NodeId(ua.Int32(ua.ObjectIds.Server))


@dataclass(frozen=True, slots=True)
class EventInfo:
    """An event."""

    event_id: bytes
    """The same wherever it is told."""
    type_name: str
    """E.g. `SkillTransitionEventType`."""
    time: datetime | None
    severity: int
    """1 to 1000."""
    message: str
    source: str
    source_node: str
    is_audit: bool
    fields: Mapping[str, Any]
    """What else it has."""


class _Events(Feed[Any]):
    """The subscription's handler, and what it hands on."""

    def event_notification(self, event: Any) -> None:
        """Called by asyncua with each event."""
        self.put(event)


class _TypeNames:
    """BrowseNames of event types, each read once."""

    def __init__(self, batches: Batches, endpoint: str) -> None:
        self._batches, self._endpoint = batches, endpoint
        self._known: dict[ua.NodeId, str] = {}

    async def of(self, types: Sequence[ua.NodeId]) -> list[str]:
        """The names of types, in their order; of one that there is not, its NodeId."""
        new = [one for one in dict.fromkeys(types) if one not in self._known]
        if new:
            with translated(self._endpoint):
                read = await self._batches.read(new, ua.AttributeIds.BrowseName)
            for one, data in zip(new, read, strict=True):
                name: Any = None if data.Value is None else data.Value.Value
                self._known[one] = one.to_string() if name is None else str(name.Name)
        return [self._known[one] for one in types]


async def _selection(client: Client, endpoint: str) -> tuple[list[str], ua.EventFilter]:
    """The fields that are selected, in their order, and the filter."""
    with translated(endpoint):
        index = await client.get_namespace_index(TYPES_URI)
    names = [*((name, 0) for name in (*_BASE, *_AUDIT, *_CONDITION)), *((name, index) for name in _OWN)]
    wanted = ua.EventFilter()
    wanted.SelectClauses = [
        ua.SimpleAttributeOperand(
            TypeDefinitionId=ua.NodeId(ua.Int32(ua.ObjectIds.BaseEventType)),
            BrowsePath=[ua.QualifiedName(part, place) for part in name.split("/")],
            AttributeId=ua.AttributeIds.Value,
        )
        for name, place in names
    ]
    return [name for name, _ in names], wanted


@asynccontextmanager
async def all_events(
    client: Client, batches: Batches, endpoint: str, subscriptions: Subscriptions
) -> AsyncGenerator[AsyncIterator[EventInfo]]:
    """Subscribe; all events that this user may see, until the context is left."""
    _, wanted = await _selection(client, endpoint)
    events, types = _Events(_QUEUE), _TypeNames(batches, endpoint)

    def begin(subscription: Subscription) -> Awaitable[object]:
        return subscription.subscribe_events(ua.ObjectIds.Server, evfilter=wanted, queuesize=_QUEUE)

    async def told() -> AsyncGenerator[EventInfo]:
        while (event := await events.next()) is not None:
            (name,) = await types.of([event.EventType])
            yield _info(vars(event), name)
        raise NotConnected(f"the connection to {endpoint} was lost")

    async with subscriptions.open(events, 100, begin), aclosing(told()) as iterator:
        yield iterator


async def past_events(
    client: Client, batches: Batches, endpoint: str, since: datetime, until: datetime, most: int
) -> list[EventInfo]:
    """What the server has kept of its events that this user may see, the newest first.

    Args:
        client: connected.
        batches: of this client.
        endpoint: of the server, for messages.
        since: the time of the oldest one.
        until: the time before which the newest one lies.
        most: no more than so many.

    Raises:
        AccessRefused: the server keeps no events (Bad_HistoryOperationUnsupported), or refuses the request.
        NotConnected: the connection was lost.
    """
    names, wanted = await _selection(client, endpoint)
    details = ua.ReadEventDetails(most, until, since, wanted)
    found: list[dict[str, Any]] = []
    point: bytes | None = None
    while True:
        parameters = ua.HistoryReadParameters()
        parameters.HistoryReadDetails = details
        parameters.TimestampsToReturn = ua.TimestampsToReturn.Source
        parameters.ReleaseContinuationPoints = False
        parameters.NodesToRead = [ua.HistoryReadValueId(_SERVER, ContinuationPoint=point)]
        with translated(endpoint):
            [result] = await client.uaclient.history_read(parameters)
        code = 0 if result.StatusCode is None else int(result.StatusCode.value)
        if code >> 31:
            name = ua.StatusCode(ua.UInt32(code)).name
            raise AccessRefused(code, f"the server refuses the history of its events: {name}")
        data: Any = result.HistoryData
        told: Sequence[Any] = getattr(data, "Events", None) or ()
        found += [dict(zip(names, [field.Value for field in event.EventFields], strict=True)) for event in told]
        point = result.ContinuationPoint
        if not point or len(found) >= most:
            break
    # One that no answer has room for has StatusCodes as fields (OPC 10000-11 6.6.4).
    whole = [one for one in found[:most] if isinstance(one["EventType"], ua.NodeId)]
    types = await _TypeNames(batches, endpoint).of([one["EventType"] for one in whole])
    return [_info(one, name) for one, name in zip(whole, types, strict=True)]


def _info(event: Mapping[str, Any], type_name: str) -> EventInfo:
    fields = {name: plain_value(event.get(name)) for name in (*_AUDIT, *_CONDITION, *_OWN)}
    time: datetime | None = event["Time"]
    source: ua.NodeId | None = event["SourceNode"]
    return EventInfo(
        bytes(event["EventId"] or b""),
        type_name,
        time.replace(tzinfo=UTC) if time is not None and time.tzinfo is None else time,
        int(event["Severity"] or 0),
        str(getattr(event["Message"], "Text", None) or ""),
        str(event["SourceName"] or ""),
        source.to_string() if source is not None else "",
        type_name.startswith("Audit"),
        {name: value for name, value in fields.items() if value is not None},
    )
