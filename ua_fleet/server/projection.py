"""Changes of the fleet's state onto its nodes."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from datetime import UTC, datetime
from typing import Final, NamedTuple

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
from ua_fleet.server.address_space import FleetNodes
from ua_fleet.server.convert import data_value
from ua_fleet.server.skills.tracker import SkillTransitioned
from ua_fleet.values import ARRAY, BuiltinType, datetime_from_ticks

__all__ = ["Projection"]

_TEXTS: Final = int(BuiltinType.STRING | ARRAY)
BATCH: Final = 250
"""Writes after which clients get their turn: about 3 ms of work."""


class _Then(NamedTuple):
    action: Callable[[], Awaitable[None]]


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
    ) -> None:
        """Make a projection onto built nodes; the others make events: of a skill, and of capacities gained and lost."""
        self._tell_capacities = tell_capacities
        self._nodes = nodes
        self._now = now
        self._tell = tell
        self._waiting: deque[Change | SkillTransitioned | _Then] = deque()
        self._wake = asyncio.Event()

    def put(self, change: Change | SkillTransitioned) -> None:
        """Queue a change for `run`."""
        self._waiting.append(change)
        self._wake.set()

    def then(self, action: Callable[[], Awaitable[None]]) -> None:
        """Do something once all that was put before is written."""
        self._waiting.append(_Then(action))
        self._wake.set()

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
        waiting = self._waiting
        while waiting:
            await self._write(min(len(waiting), BATCH))
            await asyncio.sleep(0)

    async def _write(self, count: int) -> None:
        now = self._now()
        values = self._nodes.values
        last_ticks: int | None = None
        source_time: datetime | None = None
        for _ in range(count):
            change = self._waiting.popleft()
            if type(change) is not ValueChanged:
                await self._apply(change)
                continue
            held = values.get(change.key)
            if held is None:
                continue
            ticks = change.source_timestamp
            if ticks != last_ticks:
                last_ticks = ticks
                source_time = None if ticks is None else datetime_from_ticks(ticks)
            value = data_value(change.type, change.value, change.status, source_time, now)
            held.value = value
            watchers = held.datachange_callbacks
            if watchers:
                for handle, tell in tuple(watchers.items()):
                    await tell(handle, value)

    async def _set_capacities(self, change: CapacitiesChanged) -> None:
        gained, lost = self._nodes.set_capacities(change.robot, change.holds)
        if not gained and not lost:
            return
        now, held = self._now(), self._nodes.values[change.robot.part("Capacities")]
        held.value = value = data_value(_TEXTS, change.holds, 0, now, now)
        for handle, tell in tuple(held.datachange_callbacks.items()):
            await tell(handle, value)
        if self._tell_capacities is not None:
            await self._tell_capacities(change, gained, lost)

    async def _apply(self, change: Change | SkillTransitioned | _Then) -> None:
        match change:
            case SkillTransitioned():
                if self._tell is not None:
                    await self._tell(change)
            case SourceAdded():
                self._nodes.add_source(change.data_set)
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
                await change.action()
            case _:
                pass
