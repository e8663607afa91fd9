# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""How all robots stand, from `Fleet/Summaries`: a hundred in a Variable, for lists of them."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Final

from asyncua import Node, ua
from asyncua.common.subscription import DataChangeNotif, Subscription

from ua_fleet.client.batches import Batches
from ua_fleet.client.readings import monitored_item
from ua_fleet.client.structures import StructureLayout, read_layout
from ua_fleet.client.subscriptions import Feed, Subscriptions
from ua_fleet.client.translated import NodeNotFound, translated
from ua_fleet.errors import NotConnected

__all__ = ["RobotSummary", "SummariesChanged", "read_summaries", "watch_summaries"]

_FOLDER: Final = "ns=2;s=Fleet.Summaries"
_STATES: Final = ("offline", "idle", "busy", "faulted")
"""RobotStateEnumeration of the UaFleet nodeset."""
_NO_ROBOT: Final = "there is no robot {!r}; look with: ua-fleet robot list"
_MOST_GROUPS: Final = 100_000
"""Of each the latest value waits alone, so a slow consumer makes nothing grow."""


@dataclass(frozen=True, slots=True)
class RobotSummary:
    """How one robot stands. Two are equal that say the same at different times."""

    name: str
    state: str = ""
    """`offline`, `idle`, `busy` or `faulted`."""
    state_since: datetime | None = None
    status: int = 0
    """StatusCode: the worst of the robot's values."""
    last_update: datetime | None = None
    """When data of it last reached the server; None: since the server's start nothing has."""
    task: str = ""
    """What it is at, for people; empty: nothing."""
    run_id: str = ""
    """The run of its task; empty: of none."""
    held: bool = False
    """Whether a person holds it back from tasks."""
    held_by: str = ""
    held_since: datetime | None = None
    held_reason: str = ""
    faults: int = 0
    """How many are active."""
    fault: str = ""
    """The first of them, for people."""
    bridge: str = ""
    capacities: tuple[str, ...] = ()
    told: datetime | None = field(default=None, compare=False)
    """When the server said so, by the clock that all times here are of."""

    @property
    def is_good(self) -> bool:
        """Whether all of its values are of now."""
        return self.status >> 30 == 0

    @property
    def status_text(self) -> str:
        """Name of the StatusCode, e.g. `Good` or `BadNoCommunication`."""
        return str(ua.StatusCode(ua.UInt32(self.status)).name)

    def age_s(self, now: datetime | None = None) -> float | None:
        """How old the last update is, in seconds; `now` is by the server's clock, and by default when it was told."""
        at = now or self.told
        return None if at is None or self.last_update is None else max(0.0, (at - self.last_update).total_seconds())


@dataclass(frozen=True, slots=True)
class SummariesChanged:
    """What is new since the last one."""

    changed: tuple[RobotSummary, ...]
    """Robots that have come or stand otherwise than before."""
    gone: tuple[str, ...]
    """Names of robots that are no longer there."""
    is_whole: bool
    """Whether each robot that is there has been told by now."""


def _summary(told: Mapping[str, Any], at: datetime | None) -> RobotSummary:
    """Fields that a server of another version does not tell have their defaults."""
    state = told.get("State")
    return RobotSummary(
        name=told.get("Name") or "",
        state=_STATES[state] if isinstance(state, int) and state in range(len(_STATES)) else str(state),
        state_since=told.get("StateSince"),
        status=told.get("Quality", ua.StatusCodes.BadWaitingForInitialData),
        last_update=told.get("LastUpdate"),
        task=told.get("Task") or "",
        run_id=told.get("RunId") or "",
        held=bool(told.get("Held")),
        held_by=told.get("HeldBy") or "",
        held_since=told.get("HeldSince"),
        held_reason=told.get("HeldReason") or "",
        faults=told.get("Faults") or 0,
        fault=told.get("Fault") or "",
        bridge=told.get("Bridge") or "",
        capacities=tuple(told.get("Capacities") or ()),
        told=at,
    )


class _Reader:
    """Where the summaries stand, and how they are read."""

    def __init__(self, batches: Batches) -> None:
        self._batches = batches
        self._layout: StructureLayout | None = None

    async def groups(self) -> list[ua.NodeId]:
        """The Variables; raises NodeNotFound where the server has none."""
        (children,) = await self._batches.browse([ua.NodeId.from_string(_FOLDER)], classes=int(ua.NodeClass.Variable))
        groups = [child.NodeId for child in children]
        if groups and self._layout is None:
            (data_type,) = await self._batches.read(groups[:1], ua.AttributeIds.DataType)
            if data_type.Value is not None:
                self._layout = await read_layout(self._batches, data_type.Value.Value)
        if self._layout is None:
            raise NodeNotFound("this server has no summaries of robots (Fleet/Summaries); update it")
        return groups

    def robots(self, data: ua.DataValue) -> list[RobotSummary]:
        """The robots of a group."""
        assert self._layout is not None
        values: Sequence[Any] = data.Value.Value or () if data.Value is not None else ()
        moment: Any = data.SourceTimestamp
        at = moment if moment is None or moment.tzinfo is not None else moment.replace(tzinfo=UTC)
        return [_summary(told, at) for one in values if (told := self._layout.read(one)) is not None]


async def read_summaries(batches: Batches) -> list[RobotSummary]:
    """All robots, in the order of the server; raises asyncua's errors, and NodeNotFound."""
    reader = _Reader(batches)
    values = await batches.read(await reader.groups())
    return [robot for data in values for robot in reader.robots(data)]


class _Groups(Feed[ua.NodeId]):
    """The subscription's handler: of each group the newest value waits, in the order in which the groups changed."""

    def __init__(self) -> None:
        super().__init__(_MOST_GROUPS)
        self.newest: dict[ua.NodeId, ua.DataValue] = {}

    def datachange_notification(self, node: Node, val: Any, data: DataChangeNotif) -> None:
        """Called by asyncua with each change."""
        waits = node.nodeid in self.newest
        self.newest[node.nodeid] = data.monitored_item.Value
        if not waits:
            self.put(node.nodeid)


class _Known:
    """What was told of all groups, and what is new of it."""

    def __init__(self) -> None:
        self._groups: dict[ua.NodeId, dict[str, RobotSummary]] = {}
        self._group_of: dict[str, ua.NodeId] = {}

    def count(self) -> int:
        """Groups that were told."""
        return len(self._groups)

    def take(self, group: ua.NodeId, robots: Sequence[RobotSummary]) -> tuple[list[RobotSummary], list[str]]:
        """Robots of a group that stand otherwise, and the names of those that are gone."""
        before = self._groups.get(group, {})
        now = self._groups[group] = {robot.name: robot for robot in robots}
        changed = [robot for robot in robots if before.get(robot.name) != robot]
        for name in now:
            self._group_of[name] = group
        # One that has moved to another group is not gone.
        gone = [name for name in before.keys() - now.keys() if self._group_of.get(name) == group]
        for name in gone:
            del self._group_of[name]
        return changed, gone


async def watch_summaries(
    batches: Batches, subscriptions: Subscriptions, endpoint: str, period_ms: float, robot: str = ""
) -> AsyncGenerator[SummariesChanged]:
    """How all robots stand, then each change; see `FleetClient.watch_summaries`."""
    reader, feed, known = _Reader(batches), _Groups(), _Known()
    watched: list[ua.NodeId] = []
    opened: list[Subscription] = []

    async def add(subscription: Subscription, groups: Sequence[ua.NodeId]) -> None:
        at_once = await batches.monitored_items_at_once()
        for at in range(0, len(groups), at_once):
            part = groups[at : at + at_once]
            items = [_item(group, len(watched) + place) for place, group in enumerate(part)]
            watched.extend(part)
            for result in await subscription.create_monitored_items(items):
                if isinstance(result, ua.StatusCode):
                    raise NodeNotFound(f"the summaries of robots cannot be watched: {result.name}")

    async def group_of(groups: Sequence[ua.NodeId]) -> ua.NodeId:
        for group, data in zip(groups, await batches.read(groups), strict=True):
            if any(one.name == robot for one in reader.robots(data)):
                return group
        raise NodeNotFound(_NO_ROBOT.format(robot))

    async def begin(subscription: Subscription) -> None:
        opened.append(subscription)
        groups = await reader.groups()
        await add(subscription, [await group_of(groups)] if robot else groups)

    async with subscriptions.open(feed, period_ms, begin):
        while (group := await feed.next()) is not None:
            robots = reader.robots(feed.newest.pop(group))
            changed, gone = known.take(group, robots)
            if robot:
                if all(one.name != robot for one in robots):
                    raise NodeNotFound(_NO_ROBOT.format(robot))
                mine = tuple(one for one in changed if one.name == robot)
                if mine:
                    yield SummariesChanged(mine, (), is_whole=True)
                continue
            if robots and group == watched[-1]:  # the last one is empty until there is another one
                with translated(endpoint):
                    there = await reader.groups()
                    await add(opened[0], [one for one in there if one not in watched])
            yield SummariesChanged(tuple(changed), tuple(gone), known.count() == len(watched))
        raise NotConnected(f"the connection to {endpoint} was lost")


def _item(group: ua.NodeId, handle: int) -> ua.MonitoredItemCreateRequest:
    item = monitored_item(group, handle, with_times=False)
    item.RequestedParameters.QueueSize = ua.Counter(1)
    return item
