# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""The conditions of a server (OPC 10000-9): those that are to be looked at, and what becomes of them.

    subscribe to events of the Server, ConditionRefresh -> what is retained -> `ConditionsKnown` -> each change

What is disabled, suppressed or shelved while it is inactive is not retained, so no refresh tells it: the server lists
it in `Fleet.Alarms.PutAside`, and it is read once, after the refresh. Its changes are events as all others. An alarm
that is inactive otherwise is told by nothing: `declared_alarms` browses the names of all, and reads none of them.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Mapping
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Final

from asyncua import Client, ua
from asyncua.common.subscription import Subscription
from asyncua.ua.uaerrors import BadRefreshInProgress

from ua_fleet.client.batches import Batches
from ua_fleet.client.calls import call
from ua_fleet.client.subscriptions import Feed, Subscriptions
from ua_fleet.client.translated import translated
from ua_fleet.errors import NotConnected
from ua_fleet.topics import TYPES_URI

__all__ = ["ConditionInfo", "ConditionsKnown", "DeclaredAlarm", "conditions_told", "declared_alarms"]

_FAULT_ALARM: Final = 1025
"""FaultAlarmType; see nodesets/UaFleet.NodeIds.csv."""
_KINDS: Final = {
    ua.ObjectIds.ExclusiveLevelAlarmType: "limit",
    ua.ObjectIds.OffNormalAlarmType: "off_normal",
    ua.ObjectIds.CertificateExpirationAlarmType: "certificate",
    ua.ObjectIds.DialogConditionType: "dialog",
}
_SHELVED: Final = {
    ua.ObjectIds.ShelvedStateMachineType_TimedShelved: "timed",
    ua.ObjectIds.ShelvedStateMachineType_OneShotShelved: "one_shot",
}
_START, _END, _REQUIRED = (
    ua.NodeId(ua.Int32(kind))
    for kind in (
        ua.ObjectIds.RefreshStartEventType,
        ua.ObjectIds.RefreshEndEventType,
        ua.ObjectIds.RefreshRequiredEventType,
    )
)
_FRAMES: Final = (_START, _END, _REQUIRED)
_STANDARD: Final = (
    *("EventId", "EventType", "SourceNode", "SourceName", "Time", "Message", "Severity", "ConditionName", "Retain"),
    *("EnabledState/Id", "ActiveState/Id", "ActiveState/TransitionTime", "AckedState/Id", "ConfirmedState/Id"),
    *("SuppressedState/Id", "ShelvingState/CurrentState/Id", "ShelvingState/UnshelveTime", "LimitState/CurrentState"),
    *("Quality", "Comment", "ClientUserId"),
)
_OWN: Final = ("Robot", "FaultSource", "Reason", "Capacities")
"""Fields of FaultAlarmType."""
_QUEUE: Final = 10_000
_ALARMS: Final = "ns=2;s=Fleet.Alarms"
_PUT_ASIDE: Final = "ns=2;s=Fleet.Alarms.PutAside"
_MOST_READ: Final = 500
"""Alarms put aside that are read: each read makes some fifty nodes in the server."""
_STORM: Final = 1_000
"""Events in a second after which some may have been lost: a server has room for 2,000 that wait."""
_WINDOW_S: Final = 1.0
_CALM_S: Final = 2.0


@dataclass(frozen=True, slots=True)
class ConditionInfo:
    """A condition as it was told last."""

    node_id: str
    """ConditionId: the Object whose Methods are called."""
    event_id: bytes
    """Names what was told, for Acknowledge, Confirm and AddComment."""
    kind: str
    """`fault`, `limit`, `off_normal`, `certificate`, `dialog`, or `other`."""
    name: str
    """ConditionName, as `rover.speed`."""
    source_name: str
    source_node: str
    message: str
    severity: int
    """1 to 1000."""
    time: datetime | None
    retain: bool
    enabled: bool
    active: bool
    """Of a dialog: whether it waits for an answer."""
    since: datetime | None
    """Since when it is active, or is not any more."""
    acknowledged: bool
    confirmed: bool | None
    """None where it is not to be confirmed."""
    suppressed: bool
    shelving: str
    """`timed`, `one_shot`, or empty."""
    unshelve_at: datetime | None
    limit: str
    """Of a limit: `HighHigh`, `High`, `Low`, `LowLow`, or empty."""
    quality: int
    """StatusCode of the value that it watches."""
    comment: str
    comment_by: str
    robot: str = ""
    """Of a fault."""
    fault_source: str = ""
    reason: str = ""
    capacities: tuple[str, ...] = ()

    @property
    def is_put_aside(self) -> bool:
        """Whether people are not to be bothered with it now."""
        return not self.enabled or self.suppressed or bool(self.shelving)

    @property
    def is_shown(self) -> bool:
        """Whether a list of what is there has it."""
        return self.retain or self.is_put_aside


@dataclass(frozen=True, slots=True)
class ConditionsKnown:
    """All that is to be looked at has been told."""

    node_ids: frozenset[str]
    is_whole: bool
    """Whether these are all: a server with more than it has room for has told the last ones alone."""


@dataclass(frozen=True, slots=True)
class DeclaredAlarm:
    """An alarm that there is, whatever its state."""

    node_id: str
    """ConditionId."""
    name: str
    """ConditionName, as `rover.speed`."""
    kind: str
    """As of a ConditionInfo: `limit`, `off_normal`, `certificate` or `other`."""
    is_put_aside: bool
    """Whether it is disabled, suppressed or shelved: `conditions_told` tells of so many of these at most."""


class _Events(Feed[Any]):
    """The subscription's handler, and what it hands on."""

    def event_notification(self, event: Any) -> None:
        """Called by asyncua with each event."""
        self.put(event)


class _Watch:
    """One subscription to conditions."""

    def __init__(self, client: Client, batches: Batches, endpoint: str, types: int) -> None:
        self._client, self._batches, self._endpoint, self._types = client, batches, endpoint, types
        self.events = _Events(_QUEUE)
        self._subscription_id = 0
        self._seen: set[str] = set()
        self._is_whole = False
        self._is_refreshing = self._is_stormy = self._is_owed = False
        self._counted_from, self._count = 0.0, 0

    async def begin(self, subscription: Subscription) -> None:
        """Ask for the events, then for what is retained."""
        await subscription.subscribe_events(ua.ObjectIds.Server, evfilter=_filter(self._types), queuesize=_QUEUE)
        self._subscription_id = int(subscription.subscription_id or 0)
        await self._refresh()

    async def told(self) -> AsyncGenerator[ConditionInfo | ConditionsKnown]:
        """What is told; raises NotConnected when the connection is lost."""
        while True:
            try:
                async with asyncio.timeout(_CALM_S if self._is_stormy or self._count >= _STORM else None):
                    event = await self.events.next()
            except TimeoutError:
                self._is_stormy, self._count = False, 0
                await self._refresh()
                continue
            if event is None:
                raise NotConnected(f"the connection to {self._endpoint} was lost")
            if event.EventType == _START:
                self._seen, self._is_whole = set(), True
            elif event.EventType == _END:
                async for info in self._put_aside():
                    yield info
                yield ConditionsKnown(frozenset(self._seen), self._is_whole)
                self._is_whole = self._is_refreshing = False
                if self._is_owed:
                    await self._refresh()
            elif event.EventType == _REQUIRED:
                await self._refresh()
            else:
                info = self._info(event.NodeId.to_string(), vars(event))
                self._seen.add(info.node_id)
                yield info
                if not self._is_refreshing and self._is_calm_again():
                    await self._refresh()

    async def _refresh(self) -> None:
        """ConditionRefresh (OPC 10000-9 5.5.7), after the one that goes on where there is one."""
        self._is_refreshing, self._is_owed = True, False
        number = ua.Variant(self._subscription_id, ua.VariantType.UInt32)
        owner, method = ua.ObjectIds.ConditionType, ua.ObjectIds.ConditionType_ConditionRefresh
        wanted = ua.CallMethodRequest(ua.NodeId(ua.Int32(owner)), ua.NodeId(ua.Int32(method)), [number])
        with translated(self._endpoint):
            try:
                await call(self._client, wanted)
            except BadRefreshInProgress:
                self._is_owed = True

    def _is_calm_again(self) -> bool:
        """Count an event that is none of a refresh; whether a storm has passed with it."""
        now = asyncio.get_running_loop().time()
        if now - self._counted_from <= _WINDOW_S:
            self._count += 1
            return False
        before, self._count, self._counted_from = self._count, 1, now
        if before >= _STORM:
            self._is_stormy = True
            return False
        was_stormy, self._is_stormy = self._is_stormy, False
        return was_stormy

    async def _put_aside(self) -> AsyncGenerator[ConditionInfo]:
        """Alarms that the refresh has not told, since they are inactive, and that are put aside."""
        with translated(self._endpoint):
            ids = await _ids_put_aside(self._batches)
            left = [one for one in ids if one not in self._seen][:_MOST_READ]
            paths = [path.replace("/", ".") for path in _STANDARD]
            members = [ua.NodeId.from_string(f"{one}.{path}") for one in left for path in paths]
            values = await self._batches.read(members) if members else []
        for at, node in enumerate(left):
            read = values[at * len(_STANDARD) : (at + 1) * len(_STANDARD)]
            fields = {
                path: None if data.Value is None else data.Value.Value
                for path, data in zip(_STANDARD, read, strict=True)
            }
            if fields["EventType"] is not None:  # it may have gone meanwhile
                self._seen.add(node)
                yield self._info(node, fields)

    def _info(self, node: str, fields: Mapping[str, Any]) -> ConditionInfo:
        """A condition of the fields of its event, or of its members."""
        kind = self._kind(fields["EventType"])
        at, shelving = _time(fields["Time"]), ""
        unshelve_at, state = None, fields["ShelvingState/CurrentState/Id"]
        if state is not None:
            shelving = _SHELVED.get(int(state.Identifier), "")
        if shelving and at is not None:
            unshelve_at = at + timedelta(milliseconds=float(fields["ShelvingState/UnshelveTime"] or 0.0))
        retain, confirmed = bool(fields["Retain"]), fields["ConfirmedState/Id"]
        quality: Any = fields["Quality"]
        return ConditionInfo(
            node_id=node,
            event_id=bytes(fields["EventId"] or b""),
            kind=kind,
            name=str(fields["ConditionName"] or ""),
            source_name=str(fields["SourceName"] or ""),
            source_node="" if fields["SourceNode"] is None else fields["SourceNode"].to_string(),
            message=_text(fields["Message"]),
            severity=int(fields["Severity"] or 0),
            time=at,
            retain=retain,
            enabled=fields["EnabledState/Id"] is not False,
            active=retain if kind == "dialog" else fields["ActiveState/Id"] is True,
            since=at if kind == "dialog" else _time(fields["ActiveState/TransitionTime"]),
            acknowledged=fields["AckedState/Id"] is not False,
            confirmed=None if confirmed is None else bool(confirmed),
            suppressed=fields["SuppressedState/Id"] is True,
            shelving=shelving,
            unshelve_at=unshelve_at,
            limit=_text(fields["LimitState/CurrentState"]),
            quality=int(getattr(quality, "value", quality) or 0),
            comment=_text(fields["Comment"]),
            comment_by=str(fields["ClientUserId"] or ""),
            robot=str(fields.get("Robot") or ""),
            fault_source=str(fields.get("FaultSource") or ""),
            reason=str(fields.get("Reason") or ""),
            capacities=tuple(fields.get("Capacities") or ()),
        )

    def _kind(self, event_type: ua.NodeId) -> str:
        identifier: Any = event_type.Identifier
        if event_type.NamespaceIndex == self._types:
            return "fault" if identifier == _FAULT_ALARM else "other"
        return _kind_of(event_type)


def _kind_of(event_type: ua.NodeId) -> str:
    """What a type of the standard is called here."""
    identifier: Any = event_type.Identifier
    return _KINDS.get(identifier, "other") if event_type.NamespaceIndex == 0 else "other"


@asynccontextmanager
async def conditions_told(
    client: Client, batches: Batches, endpoint: str, subscriptions: Subscriptions
) -> AsyncGenerator[AsyncIterator[ConditionInfo | ConditionsKnown]]:
    """Subscribe; the conditions there are, a ConditionsKnown, then each change, until the context is left."""
    with translated(endpoint):
        watch = _Watch(client, batches, endpoint, await client.get_namespace_index(TYPES_URI))
    async with subscriptions.open(watch.events, 100, watch.begin), aclosing(watch.told()) as iterator:
        yield iterator


async def _ids_put_aside(batches: Batches) -> list[str]:
    """The ConditionIds of what is disabled, suppressed or shelved."""
    (listed,) = await batches.read([ua.NodeId.from_string(_PUT_ASIDE)])
    names: list[str] = list(listed.Value.Value or ()) if listed.Value is not None else []
    return [f"ns=2;s=Alarms.{name}" for name in names]


async def declared_alarms(batches: Batches, endpoint: str) -> list[DeclaredAlarm]:
    """The alarms of values, bridges and certificates that a server has, by their names.

    Raises:
        NotConnected: the connection was lost.
    """
    with translated(endpoint):
        (below,) = await batches.browse([ua.NodeId.from_string(_ALARMS)], classes=ua.NodeClass.Object)
        put_aside = frozenset(await _ids_put_aside(batches))
    found = [
        DeclaredAlarm(
            node := one.NodeId.to_string(), str(one.BrowseName.Name), _kind_of(one.TypeDefinition), node in put_aside
        )
        for one in below
    ]
    return sorted([one for one in found if one.kind != "dialog"], key=lambda one: one.name)


def _filter(types: int) -> ua.EventFilter:
    """Conditions of all types, and the frames of a refresh."""
    wanted = ua.EventFilter()
    paths = [[ua.QualifiedName(part, 0) for part in path.split("/")] for path in _STANDARD]
    paths += [[ua.QualifiedName(name, types)] for name in _OWN]
    wanted.SelectClauses = [_operand(path) for path in paths]
    wanted.SelectClauses.append(
        ua.SimpleAttributeOperand(
            TypeDefinitionId=ua.NodeId(ua.Int32(ua.ObjectIds.ConditionType)),
            BrowsePath=[],
            AttributeId=ua.AttributeIds.NodeId,
        )
    )
    either, is_condition, is_frame = (ua.ContentFilterElement() for _ in range(3))
    either.FilterOperator = ua.FilterOperator.Or
    either.FilterOperands = [ua.ElementOperand(Index=ua.UInt32(1)), ua.ElementOperand(Index=ua.UInt32(2))]
    is_condition.FilterOperator = ua.FilterOperator.OfType
    condition = ua.NodeId(ua.Int32(ua.ObjectIds.ConditionType))
    is_condition.FilterOperands = [ua.LiteralOperand(Value=ua.Variant(condition))]
    is_frame.FilterOperator = ua.FilterOperator.InList
    is_frame.FilterOperands = [
        _operand([ua.QualifiedName("EventType", 0)]),
        *(ua.LiteralOperand(Value=ua.Variant(one)) for one in _FRAMES),
    ]
    wanted.WhereClause.Elements = [either, is_condition, is_frame]
    return wanted


def _operand(path: list[ua.QualifiedName]) -> ua.SimpleAttributeOperand:
    return ua.SimpleAttributeOperand(
        TypeDefinitionId=ua.NodeId(ua.Int32(ua.ObjectIds.BaseEventType)),
        BrowsePath=path,
        AttributeId=ua.AttributeIds.Value,
    )


def _time(moment: datetime | None) -> datetime | None:
    return moment.replace(tzinfo=UTC) if moment is not None and moment.tzinfo is None else moment


def _text(value: Any) -> str:
    return str(getattr(value, "Text", value) or "")
