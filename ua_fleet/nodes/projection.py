"""Changes of the fleet's state onto its nodes, and events between them: one queue, so that nothing overtakes.

What waits is bounded. Of an analog value the latest replaces one that waits, as it does where a client samples. States,
texts and changes of quality are written one after the other, as they were said, until `MOST_IN_ORDER` wait: from then
on their latest replaces one that waits, too, and what clients are not told is counted (`untold`). So no more waits than
that, a value for each node, `MOST_EVENTS` events, and a change of nodes for each source that comes and goes.

What is put ahead does not wait for the others: a few values that somebody's safety hangs on, in an order of their own
and with the same bounds.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import itertools
from collections import OrderedDict, deque
from collections.abc import Awaitable, Callable, Sequence
from datetime import UTC, datetime
from typing import Final, NamedTuple

from asyncua import ua

from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.convert import data_value
from ua_fleet.fleet.changes import (
    CapacitiesChanged,
    Change,
    RobotAdded,
    RobotRemoved,
    SourceAdded,
    SourceQuarantined,
    SourceReleased,
    SourceRemoved,
    ValueChanged,
)
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.nodes.address_space import FleetNodes
from ua_fleet.operation.skills.tracker import SkillTransitioned
from ua_fleet.values import ARRAY, BuiltinType, NodeId, datetime_from_ticks

__all__ = ["Projection"]

_TEXTS: Final = int(BuiltinType.STRING | ARRAY)
BATCH: Final = 250
"""Writes after which clients get their turn: about 3 ms of work."""
EVENT: Final = 25
"""An event, or any other change that is no value, takes as long as so many writes."""
WATCHERS: Final = 4
"""Monitored items to tell that take as long as a write."""
LARGEST_BATCH: Final = 1000
"""The same while much waits, so that it is written within a second."""
MOST_IN_ORDER: Final = 5000
"""Changes that may wait before of each node the latest value alone is kept: about 60 ms of work."""
MOST_EVENTS: Final = 10_000
"""Events that may wait."""


class _Then(NamedTuple):
    action: Callable[[], Awaitable[None]]
    is_event: bool


_MAKES_NODES: Final = (SourceAdded, SourceRemoved, RobotAdded, RobotRemoved)

_Waiting = Change | SkillTransitioned | _Then


class _Slot:
    """A place in the queue; what stands there may be replaced, or taken back."""

    __slots__ = ("change", "is_waiting")

    def __init__(self, change: _Waiting) -> None:
        self.change: _Waiting | None = change
        self.is_waiting = True


class Projection:
    """Writes changes to nodes in the order in which they were told.

    A value goes straight into what asyncua holds for the node, and to the monitored items that watch it: its own write
    method would compare the type once more, and take the value away from a node that becomes Bad.
    """

    def __init__(
        self,
        nodes: FleetNodes,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
        *,
        tell: Callable[[SkillTransitioned], Awaitable[None]] | None = None,
        tell_capacities: Callable[[CapacitiesChanged, Sequence[str], Sequence[str]], Awaitable[None]] | None = None,
        mistakes: Mistakes | None = None,
    ) -> None:
        """Make a projection onto built nodes.

        Args:
            nodes: the fleet's.
            now: time of the server.
            tell: makes the event of a skill.
            tell_capacities: makes the event of capacities gained and lost.
            mistakes: counts what has cost a change; its own without.
        """
        self._tell_capacities = tell_capacities
        self._nodes = nodes
        self._now = now
        self._tell = tell
        self._mistakes = mistakes or Mistakes()
        self._ahead: OrderedDict[tuple[NodeId, int], ValueChanged] = OrderedDict()
        """What is put ahead, by its node and a number where it is not to be replaced; else 0."""
        self._numbers = itertools.count(1)
        self._waiting: deque[_Slot] = deque()
        self._latest: dict[NodeId, _Slot] = {}
        """The last value of each node that waits, where a newer one may take its place."""
        self._added: dict[NodeId, _Slot] = {}
        """The SourceAdded of each source that waits, or the place of one that was taken back."""
        self._events = 0
        self._wake = asyncio.Event()
        self.untold = 0
        """States and events that clients were not told, since too much waited."""

    @property
    def waiting(self) -> int:
        """Changes and events that wait."""
        return len(self._ahead) + len(self._waiting)

    def put(self, change: Change | SkillTransitioned) -> None:
        """Queue a change for `run`."""
        if type(change) is ValueChanged:
            self._put_value(change)
        elif isinstance(change, SkillTransitioned):
            self._put_event(change)
        elif isinstance(change, SourceAdded):
            self._put_added(change)
        elif isinstance(change, SourceRemoved):
            self._put_removed(change)
        else:
            self._added.clear()
            self._append(change)

    def put_ahead(self, change: ValueChanged) -> None:
        """Queue a value before all that waits, and behind what was put ahead before; a node has all its values so."""
        is_latest = change.can_wait or len(self._ahead) >= MOST_IN_ORDER
        key = change.key, 0 if is_latest else next(self._numbers)
        replaced = self._ahead.pop(key, None)
        self.untold += replaced is not None and not change.can_wait
        self._ahead[key] = change
        self._wake.set()

    def then(self, action: Callable[[], Awaitable[None]]) -> None:
        """Do something once all that was put before is written."""
        self._append(_Then(action, is_event=False))

    def tell(self, event: Callable[[], Awaitable[None]]) -> None:
        """Make an event once all that was put before is written; one among too many is counted, and not made."""
        self._put_event(_Then(event, is_event=True))

    def _put_value(self, change: ValueChanged) -> None:
        slot = self._latest.get(change.key)
        if slot is not None and slot.is_waiting:
            before = slot.change
            if type(before) is not ValueChanged:  # taken back with its node, which is made anew before this place
                slot.change = change
                return
            can_wait = change.can_wait and before.can_wait
            if can_wait or len(self._waiting) >= MOST_IN_ORDER:
                slot.change = change
                self.untold += not can_wait
                return
        self._latest[change.key] = self._queue(change)

    def _put_event(self, event: SkillTransitioned | _Then) -> None:
        if self._events >= MOST_EVENTS:
            self.untold += 1
            return
        self._events += 1
        if len(self._waiting) < MOST_IN_ORDER:
            self._latest.clear()  # what is said after the event is not shown before it
        self._queue(event)

    def _put_added(self, change: SourceAdded) -> None:
        key = change.data_set.key
        slot = self._added.get(key)
        if slot is not None and slot.is_waiting and slot.change is None:
            slot.change = change
            return
        self._added[key] = self._append(change)

    def _put_removed(self, change: SourceRemoved) -> None:
        for field in change.data_set.fields:
            value = self._latest.get(field.key)
            if value is not None:
                value.change = None  # its node goes
        slot = self._added.get(change.data_set.key)
        if slot is not None and slot.is_waiting and isinstance(slot.change, SourceAdded):
            slot.change = None  # its nodes were never made
            return
        self._append(change)

    def _append(self, change: _Waiting) -> _Slot:
        """Queue what nothing may be moved across."""
        self._latest.clear()
        return self._queue(change)

    def _queue(self, change: _Waiting) -> _Slot:
        slot = _Slot(change)
        self._waiting.append(slot)
        self._wake.set()
        return slot

    async def settled(self) -> None:
        """Wait until all that was put before is written, which `run` does."""
        written = asyncio.Event()

        async def done() -> None:
            written.set()

        self.then(done)
        await written.wait()

    async def run(self) -> None:
        """Write what is put, until cancelled."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            await self.write_waiting()

    async def write_waiting(self) -> None:
        """Write all that waits; others get their turn after each batch."""
        while waiting := self.waiting:
            await self._write(min(waiting, max(BATCH, min(waiting // 8, LARGEST_BATCH))))
            await asyncio.sleep(0)

    async def _write(self, count: int) -> None:
        now = self._now()
        values = self._nodes.values
        last_ticks: int | None = None
        source_time: datetime | None = None
        while count > 0 and (self._ahead or self._waiting):
            count -= 1
            slot: _Slot | None = None
            change: _Waiting | None
            if self._ahead:
                _, change = self._ahead.popitem(last=False)
            else:
                slot = self._waiting.popleft()
                change, slot.is_waiting = slot.change, False
            if change is None:
                continue
            if type(change) is not ValueChanged:
                count -= EVENT
                try:
                    await self._apply(change)
                except Exception as error:  # noqa: BLE001 - what is behind it has nothing to do with it
                    self._mistakes.caught("projection", error, what=type(change).__name__)
                if isinstance(change, _MAKES_NODES):
                    return  # hundreds of them, as many as a batch of values takes
                continue
            if slot is not None and self._latest.get(change.key) is slot:
                del self._latest[change.key]
            held = values.get(change.key) or self._nodes.value(change.key)
            if held is None:
                continue
            try:
                ticks = change.source_timestamp
                if ticks != last_ticks:
                    source_time = None if ticks is None else datetime_from_ticks(ticks)
                    last_ticks = ticks
                held.value = value = data_value(change.type, change.value, change.status, source_time, now)
            except Exception as error:  # noqa: BLE001 - as above
                self._mistakes.caught("values", error, node=str(change.key))
                continue
            if held.is_watched:
                count -= await self._tell_watchers(held, value) // WATCHERS

    async def _tell_watchers(self, held: HeldValue, value: ua.DataValue) -> int:
        """Tell the monitored items of a node; how many there are."""
        watchers = tuple(held.datachange_callbacks.items())
        for handle, tell in watchers:
            try:
                await tell(handle, value)
            except Exception as error:  # noqa: BLE001 - one client's item must not keep the others from the value
                self._mistakes.caught("monitored items", error)
        return len(watchers)

    async def _set_capacities(self, change: CapacitiesChanged) -> None:
        gained, lost = self._nodes.set_capacities(change.robot, change.holds)
        if not gained and not lost:
            return
        now, held = self._now(), self._nodes.values[change.robot.part("Capacities")]
        held.value = value = data_value(_TEXTS, change.holds, 0, now, now)
        await self._tell_watchers(held, value)
        if self._tell_capacities is not None:
            await self._tell_capacities(change, gained, lost)

    async def _apply(self, change: _Waiting) -> None:
        match change:
            case SkillTransitioned():
                self._events -= 1
                if self._tell is not None:
                    await self._tell(change)
            case SourceAdded():
                self._added.pop(change.data_set.key, None)
                await self._nodes.add_source(change.data_set)
            case SourceRemoved():
                await self._nodes.remove_source(change.data_set)
            case SourceQuarantined():
                self._nodes.add_quarantined(change)
            case SourceReleased():
                await self._nodes.remove_quarantined(change.topic)
            case CapacitiesChanged():
                await self._set_capacities(change)
            case RobotAdded():
                self._nodes.add_robot(change.robot)
            case RobotRemoved():
                await self._nodes.remove_robot(change.robot)
            case _Then():
                self._events -= change.is_event
                await change.action()
            case _:
                pass
