"""Runs the assembly line: server, ROS master, bridges and robots as processes, watched as one OPC UA client."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import AbstractAsyncContextManager, aclosing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from ua_fleet.client import Change, FleetClient, NodeNotFound
from ua_fleet.demo.launch import START_TIMEOUT_S, Launch
from ua_fleet.demo.lines import read_line
from ua_fleet.demo.pal.setting import Setting
from ua_fleet.demo.pal.timeline import Timeline
from ua_fleet.demo.processes import DemoFailed, Processes
from ua_fleet.errors import UaFleetError

__all__ = ["PalResult", "run_pal"]

ROBOTS: Final = Path(__file__).resolve().parent / "robots"
CONVEYOR_OFF_S: Final = 25.0
LINE_TIMEOUT_S: Final = 180.0
"""The line's seconds after which covers that have not arrived are given up; a run takes about 100."""

CONVEYOR, ON_CONVEYOR, ON_TURTLEBOT = "ns=2;i=1001", "ns=2;i=1002", "ns=2;i=1003"
JOINTS, POSE = "ns=2;s=1005.position", "ns=2;s=1013.pose.position.x"


@dataclass(slots=True)
class PalResult:
    """How the run ended: what goes into the JSON file, and whether it was as it should be."""

    report: dict[str, Any]
    delays: list[tuple[str, str, str]]
    problems: list[str] = field(default_factory=list[str])


class _Run:
    def __init__(self, setting: Setting, processes: Processes, say: Callable[[str], None]) -> None:
        self._setting, self._processes, self._say = setting, processes, say
        self._launch = Launch(setting.site, processes, () if setting.loop_rule else ("--without-loop-rule",))
        self.timeline = Timeline(setting.speed)
        self._ready: set[str] = set()
        self.changed = asyncio.Event()

    # What the robots' programs say.

    def robot_says(self, line: str) -> None:
        """One line on the stdout of a robot's program."""
        event = read_line(line)
        if event is None:
            return
        if event.what == "is ready" or (event.who, event.what) == ("turtlebot3", "stands at the park"):
            self._ready.add(event.who)
        text = self.timeline.add(event)
        if text is not None:
            self._say(text)
        if (event.who, event.what) == ("ned", "starts"):
            self._processes.write_line("operator", str(event.t + CONVEYOR_OFF_S / self._setting.speed))
        self.changed.set()

    # What the server's nodes say.

    def server_says(self, change: Change) -> None:
        """One change of a node's value, from the subscription."""
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

    # The processes.

    async def start_infrastructure(self) -> None:
        """Start the server, the ROS master and both bridges, and wait until they are ready."""
        launch = self._launch
        await launch.prepare()
        if self._setting.arm_ros == 1:
            await launch.master()
        await launch.server()
        await launch.bridge("arm_side", self._setting.arm_ros)
        await launch.bridge("mobile_side", 2)
        await launch.ready("server", "arm_side", "mobile_side")

    async def _start_robot(self, name: str, script: str, domain: int | None, *args: str) -> None:
        has_stdin = name == "operator"
        await self._launch.robot(name, ROBOTS / script, domain, *args, on_line=self.robot_says, stdin=has_stdin)

    async def start_robots(self) -> None:
        """Start the robots' programs; the arm begins by itself once it has heard of the park and the bucket."""
        setting = self._setting
        speed = ("--speed", str(setting.speed))
        spaces = ("--space", str(setting.mobile_space), "--arm-space", str(setting.arm_space))
        arm_ros = ("--ros", str(setting.arm_ros))
        domain = None if setting.arm_ros == 1 else setting.arm_space
        await self._start_robot("operator", "operator_panel.py", domain, *arm_ros)
        await self._start_robot("human", "human.py", setting.mobile_space, *spaces, *speed)
        await self._until(lambda: {"operator", "human"} <= self._ready, START_TIMEOUT_S, "the human and the operator")
        await self._start_robot("turtlebot3", "turtlebot3.py", setting.mobile_space, *spaces, *speed)
        await self._until(lambda: "turtlebot3" in self._ready, START_TIMEOUT_S, "the TurtleBot3")
        arm_spaces = ("--space", str(setting.arm_space), "--turtlebot-space", str(setting.mobile_space))
        await self._start_robot("ned", "ned.py", domain, *arm_ros, *arm_spaces, *speed)
        await self._until(lambda: self.timeline.started is not None, START_TIMEOUT_S, "the arm")

    def connect(self) -> AbstractAsyncContextManager[FleetClient]:
        """The client that watches."""
        return self._launch.connect()

    async def _until(self, condition: Callable[[], bool], timeout_s: float, what: str) -> None:
        await self._processes.until(condition, self.changed, timeout_s, what)

    async def until_delivered(self) -> list[str]:
        """Wait until all covers have arrived; what went wrong, if they do not."""
        timeout_s = LINE_TIMEOUT_S / self._setting.speed + 10
        try:
            await self._until(lambda: self.timeline.all_delivered, timeout_s, "all covers to arrive")
        except DemoFailed as error:
            return [str(error)]
        return []

    def result(self, looped: int, drops: Mapping[str, int], problems: list[str]) -> PalResult:
        """The result with what the status nodes say."""
        if looped:
            problems = [*problems, f"{looped} messages were delivered twice to one place"]
        ros1 = self._setting.arm_ros == 1
        report = self.timeline.report(looped=looped, drops=drops, ros1=ros1, secure=self._setting.site.secure)
        return PalResult(report, self.timeline.delay_table(ros1=ros1), problems)


async def _watch(client: FleetClient, run: _Run, nodes: list[str]) -> None:
    """Follow some of the server's nodes; those made from announcements appear only when their robots do."""
    while True:
        try:
            await client.read(nodes)
            break
        except NodeNotFound:
            await asyncio.sleep(0.1)
    async with aclosing(client.watch(nodes, period_ms=50)) as changes:
        async for change in changes:
            run.server_says(change)


async def _totals(client: FleetClient) -> tuple[int, dict[str, int]]:
    """Deliveries that looped and drops by cause, over the server and both bridges, from their status nodes."""
    looped, drops = 0, Counter[str]()
    for place in ("Traffic", "Bridges/arm_side", "Bridges/mobile_side"):
        path = f"Fleet/{place}"
        (reading,) = await client.read([f"{path}/Looped"])
        looped += int(reading.value or 0)
        causes = await client.browse(f"{path}/Drops")
        for node, value in zip(causes, await client.read([node.node_id for node in causes]), strict=True):
            drops[node.browse_name] += int(value.value or 0)
    return looped, dict(sorted((cause, count) for cause, count in drops.items() if count))


async def run_pal(
    setting: Setting,
    *,
    say: Callable[[str], None],
    started: Callable[[], None],
    finished: Callable[[PalResult], None],
    stay: bool,
) -> None:
    """Run the line once; with `stay` keep everything up afterwards until cancelled.

    Args:
        setting: ports, folder, speed.
        say: prints a line of the timeline.
        started: called once clients can connect.
        finished: called with the result when all covers have arrived.
        stay: whether to go on until cancelled.

    Raises:
        DemoFailed: a process did not start, ended too early, or the covers did not arrive in time.
    """
    async with Processes(setting.site.folder / "log") as processes:
        run = _Run(setting, processes, say)
        await run.start_infrastructure()
        started()
        async with run.connect() as client:
            await _with_client(client, run, processes, finished, stay=stay)


async def _with_client(
    client: FleetClient, run: _Run, processes: Processes, finished: Callable[[PalResult], None], *, stay: bool
) -> None:
    try:
        async with asyncio.TaskGroup() as tasks:
            watching = [
                tasks.create_task(_watch(client, run, nodes))
                for nodes in ([CONVEYOR, ON_CONVEYOR, ON_TURTLEBOT], [JOINTS, POSE])
            ]
            try:
                await run.start_robots()
                problems = await run.until_delivered()
                # The bridges publish their status each second.
                await asyncio.sleep(1.5)
                finished(run.result(*await _totals(client), problems))
                while stay:
                    processes.check()
                    await asyncio.sleep(0.5)
            finally:
                for task in watching:
                    task.cancel()
    except ExceptionGroup as group:
        failed, other = group.split(UaFleetError)
        if failed is None or other is not None:
            raise
        raise failed.exceptions[0] from None
