# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Everything that a server tells of as an event, whatever its type, with the fields that most types have."""

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Mapping
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
from ua_fleet.errors import NotConnected
from ua_fleet.topics import TYPES_URI

__all__ = ["EventInfo", "all_events"]

_BASE: Final = ("EventType", "SourceNode", "SourceName", "Time", "Message", "Severity")
_AUDIT: Final = ("ClientUserId", "Status", "StatusCodeId")
_CONDITION: Final = (
    *("ConditionName", "EnabledState", "ActiveState", "AckedState", "ConfirmedState", "SuppressedState"),
    *("ShelvingState/CurrentState", "LimitState/CurrentState", "Comment"),
)
_OWN: Final = ("Robot", "Skill", "RunId", "Task", "Reason")
"""Fields of ours that some types have."""
_QUEUE: Final = 10_000


@dataclass(frozen=True, slots=True)
class EventInfo:
    """An event."""

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


@asynccontextmanager
async def all_events(
    client: Client, batches: Batches, endpoint: str, subscriptions: Subscriptions
) -> AsyncGenerator[AsyncIterator[EventInfo]]:
    """Subscribe; all events that this user may see, until the context is left."""
    with translated(endpoint):
        index = await client.get_namespace_index(TYPES_URI)
    events, wanted = _Events(_QUEUE), ua.EventFilter()
    names = [*((name, 0) for name in (*_BASE, *_AUDIT, *_CONDITION)), *((name, index) for name in _OWN)]
    wanted.SelectClauses = [
        ua.SimpleAttributeOperand(
            TypeDefinitionId=ua.NodeId(ua.Int32(ua.ObjectIds.BaseEventType)),
            BrowsePath=[ua.QualifiedName(part, place) for part in name.split("/")],
            AttributeId=ua.AttributeIds.Value,
        )
        for name, place in names
    ]

    def begin(subscription: Subscription) -> Awaitable[object]:
        return subscription.subscribe_events(ua.ObjectIds.Server, evfilter=wanted, queuesize=_QUEUE)

    async def told() -> AsyncGenerator[EventInfo]:
        types: dict[ua.NodeId, str] = {}
        while (event := await events.next()) is not None:
            if event.EventType not in types:
                with translated(endpoint):
                    (data,) = await batches.read([event.EventType], ua.AttributeIds.BrowseName)
                name = data.Value.Value.Name if data.Value is not None else event.EventType.to_string()
                types[event.EventType] = str(name)
            yield _info(event, types[event.EventType])
        raise NotConnected(f"the connection to {endpoint} was lost")

    async with subscriptions.open(events, 100, begin), aclosing(told()) as iterator:
        yield iterator


def _info(event: Any, type_name: str) -> EventInfo:
    fields = {name: plain_value(getattr(event, name, None)) for name in (*_AUDIT, *_CONDITION, *_OWN)}
    time: datetime | None = event.Time
    return EventInfo(
        type_name,
        time.replace(tzinfo=UTC) if time is not None and time.tzinfo is None else time,
        int(event.Severity or 0),
        str(getattr(event.Message, "Text", None) or ""),
        str(event.SourceName or ""),
        event.SourceNode.to_string() if event.SourceNode is not None else "",
        type_name.startswith("Audit"),
        {name: value for name, value in fields.items() if value is not None},
    )
