"""Watches the assembly line: what its members say, and the server's nodes as any OPC UA client sees them."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import aclosing, suppress
from typing import Final

from ua_demo.failing import first_failure
from ua_demo.lines import LineEvent
from ua_demo.pal.timeline import Timeline
from ua_demo.result import DemoResult
from ua_fleet.client import Change, FleetClient, NodeNotFound
from ua_fleet.counters import NO_LOSS, Drop

__all__ = ["Conductor"]

LINE_TIMEOUT_S: Final = 180.0
"""The line's seconds after which covers that have not arrived are given up; a run takes about 100."""
GRACE_S: Final = 10.0
"""Wall seconds beside these."""
LOOK_S: Final = 0.5
REST_S: Final = 1.5
"""The bridges publish their status each second."""

CONVEYOR, ON_CONVEYOR, ON_TURTLEBOT = "ns=2;i=1001", "ns=2;i=1002", "ns=2;i=1003"
_COUNTED: Final = ("Fleet/Traffic", "Fleet/Bridges/arm_side", "Fleet/Bridges/mobile_side")
JOINTS, POSE = "ns=2;s=1005.position", "ns=2;s=1013.pose.position.x"


class Conductor:
    """One for all connections: the line goes on while the server is away."""

    def __init__(
        self,
        *,
        speed: float,
        ros1: bool,
        secure: bool,
        say: Callable[[str], None],
        check: Callable[[], None],
        finished: Callable[[DemoResult], None],
        hold_s: float = 0.0,
        until_looped: bool = False,
    ) -> None:
        """Prepare for any number of connections.

        Args:
            speed: how many times faster than in the paper.
            ros1: whether the arm runs in ROS 1.
            secure: whether PubSub is signed and encrypted.
            say: prints a line of the timeline.
            check: raises where going on makes no sense; looked at now and then.
            finished: called with the result of each run.
            hold_s: so much later the server's changes are taken in, where what robots say takes that long to come.
            until_looped: a run is over when messages have come round, too: without the loop rule they go on doing so.
        """
        self._speed, self._ros1, self._secure = speed, ros1, secure
        self._say, self._check, self._finished, self._hold_s = say, check, finished, hold_s
        self._until_looped = until_looped
        self.timeline = Timeline(speed)
        self._is_reported = False
        self._changed = asyncio.Event()

    def robot_says(self, event: LineEvent) -> None:
        """Take in what a member of the line says; its arm begins a run."""
        if (event.who, event.what) == ("ned", "starts"):
            self.timeline, self._is_reported = Timeline(self._speed), False
        try:
            text = self.timeline.add(event)
        except (KeyError, TypeError, ValueError):
            return  # without what belongs to it: no program of this line said that
        if text is not None:
            self._say(text)
        self._changed.set()

    def server_says(self, change: Change) -> None:
        """Take in a change of a node's value, from the subscription."""
        if change.status or change.server_time is None or change.source_time is None:
            return
        timeline, server_time = self.timeline, change.server_time.timestamp()
        if change.node_id == CONVEYOR:
            text = timeline.server_saw_conveyor(bool(change.value), server_time)
            if text is not None:
                self._say(text)
        elif change.node_id in (ON_CONVEYOR, ON_TURTLEBOT):
            carrier = "conveyor" if change.node_id == ON_CONVEYOR else "turtlebot3"
            timeline.server_saw_counter(carrier, int(change.value), server_time)
        elif timeline.started is not None:
            delay_ms = (change.server_time - change.source_time).total_seconds() * 1000
            (timeline.ros1_to_server_ms if change.node_id == JOINTS else timeline.ros2_to_server_ms).append(delay_ms)

    async def follow(self, client: FleetClient, *, stay: bool) -> None:
        """Watch the server's nodes until a run is over, and then tell its result; with `stay` go on with the next.

        Raises:
            UaFleetError: the connection was lost. Where there is another one, this is to be called again.
        """
        with first_failure():
            async with asyncio.TaskGroup() as tasks:
                watching = [
                    tasks.create_task(self._watch(client, nodes))
                    for nodes in ([CONVEYOR, ON_CONVEYOR, ON_TURTLEBOT], [JOINTS, POSE])
                ]
                try:
                    while True:
                        await self._until_over(client)
                        await asyncio.sleep(REST_S)
                        self._finished(self._result(*await _totals(client)))
                        self._is_reported = True
                        if not stay:
                            return
                finally:
                    for task in watching:
                        task.cancel()

    async def _watch(self, client: FleetClient, nodes: Sequence[str]) -> None:
        """Follow some of the server's nodes; those made from announcements appear only when their robots do."""
        while True:
            try:
                await client.read(nodes)
                break
            except NodeNotFound:
                await asyncio.sleep(0.1)
        async with aclosing(client.watch(nodes, period_ms=50)) as changes:
            async for change in changes:
                if self._hold_s:
                    asyncio.get_running_loop().call_later(self._hold_s, self.server_says, change)
                else:
                    self.server_says(change)

    async def _until_over(self, client: FleetClient) -> None:
        """Wait until a run has ended of which no result was told yet."""
        while self._is_reported or not (self.timeline.all_delivered or self._is_too_late()):
            self._check()
            if self._until_looped and self.timeline.started is not None and await _looped(client):
                return
            self._changed.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(LOOK_S):
                    await self._changed.wait()

    def _is_too_late(self) -> bool:
        started = self.timeline.started
        return started is not None and time.time() > started + LINE_TIMEOUT_S / self._speed + GRACE_S

    def _result(self, looped: int, drops: Mapping[str, int]) -> DemoResult:
        is_late = not self.timeline.all_delivered and self._is_too_late()
        problems = ["not all covers have arrived in time"] if is_late else []
        if looped:
            problems.append(f"{looped} messages were delivered twice to one place")
        report = self.timeline.report(looped=looped, drops=drops, ros1=self._ros1, secure=self._secure)
        lines = [f"{'delay':<56} {'in the paper':>13}   here"]
        lines += [
            f"{what:<56} {paper:>13}   {here}" for what, paper, here in self.timeline.delay_table(ros1=self._ros1)
        ]
        lost, kept_out = _split(drops)
        lines.append(f"delivered twice: {looped}; lost, by cause: {lost or 'nothing'}")
        lines.append(f"there already, and so not handed on again, by cause: {kept_out or 'nothing'}")
        return DemoResult(report, lines, problems)


def _split(drops: Mapping[str, int]) -> tuple[str, str]:
    """Drops that lost something, and those that kept what was there already from coming twice, as texts."""
    told = {Drop.NO_METADATA.value: " (at the start, before the description of its source had come)"}
    lost = [f"{cause} {count}{told.get(cause, '')}" for cause, count in drops.items() if cause not in NO_LOSS]
    return ", ".join(lost), ", ".join(f"{cause} {count}" for cause, count in drops.items() if cause in NO_LOSS)


async def _looped(client: FleetClient) -> int:
    """Deliveries that looped, over the server and both bridges, from their status nodes."""
    return sum(int(reading.value or 0) for reading in await client.read([f"{place}/Looped" for place in _COUNTED]))


async def _totals(client: FleetClient) -> tuple[int, dict[str, int]]:
    """Deliveries that looped, and drops by cause."""
    looped, drops = await _looped(client), Counter[str]()
    for place in _COUNTED:
        causes = await client.browse(f"{place}/Drops")
        for node, value in zip(causes, await client.read([node.node_id for node in causes]), strict=True):
            drops[node.browse_name] += int(value.value or 0)
    return looped, dict(sorted((cause, count) for cause, count in drops.items() if count))
