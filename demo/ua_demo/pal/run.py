"""The assembly line on one machine: server, ROS master, bridges and robots as processes beside the conductor."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from ua_demo.failing import first_failure
from ua_demo.launch import START_TIMEOUT_S, Launch
from ua_demo.lines import read_line
from ua_demo.pal.conductor import Conductor
from ua_demo.pal.setting import IN_ARM_SPACE, Setting, robot_arguments
from ua_demo.processes import Processes
from ua_demo.result import DemoResult

__all__ = ["run_pal"]


class _Hall:
    """The processes."""

    def __init__(self, setting: Setting, processes: Processes, conductor: Conductor) -> None:
        self._setting, self._processes, self._conductor = setting, processes, conductor
        self.launch = Launch(setting.site, processes, () if setting.loop_rule else ("--without-loop-rule",))
        self._ready: set[str] = set()
        self._changed = asyncio.Event()

    async def start_infrastructure(self) -> None:
        """Start the server, the ROS master, both bridges and the console, and wait until they are ready."""
        launch = self.launch
        await launch.prepare()
        await launch.broker()
        if self._setting.arm_ros == 1:
            await launch.master()
        await launch.server()
        await launch.bridge("arm_side", self._setting.arm_ros)
        await launch.bridge("mobile_side", 2)
        await launch.console()
        await launch.ready("server", "arm_side", "mobile_side")

    async def start_robots(self) -> None:
        """Start the robots' programs; the arm begins by itself once it has heard of the park and the bucket."""
        await self._start("operator_panel", "human")
        await self._until(lambda: {"operator", "human"} <= self._ready, "the human and the operator")
        await self._start("turtlebot3")
        await self._until(lambda: "turtlebot3" in self._ready, "the TurtleBot3")
        await self._start("ned")
        await self._until(lambda: self._conductor.timeline.started is not None, "the arm")

    async def _start(self, *names: str) -> None:
        setting = self._setting
        for name in names:
            space = setting.arm_space if name in IN_ARM_SPACE else setting.mobile_space
            arguments = robot_arguments(
                name, arm_space=setting.arm_space, mobile_space=setting.mobile_space, speed=setting.speed
            )
            await self.launch.robot(name, arguments, None if space == 1 else space, self._robot_says)

    async def _until(self, condition: Callable[[], bool], what: str) -> None:
        await self._processes.until(condition, self._changed, START_TIMEOUT_S, what)

    def _robot_says(self, line: str) -> None:
        event = read_line(line)
        if event is None:
            return
        if event.what in ("is ready", "stands at the park"):
            self._ready.add(event.who)
        self._conductor.robot_says(event)
        self._changed.set()


async def run_pal(
    setting: Setting,
    *,
    say: Callable[[str], None],
    started: Callable[[], None],
    finished: Callable[[DemoResult], None],
    stay: bool,
) -> None:
    """Run the line once; with `stay` keep everything up afterwards until cancelled.

    Args:
        setting: ports, folder, speed.
        say: prints a line of the timeline.
        started: called once clients can connect.
        finished: called with the result when all covers have arrived, or have not in time.
        stay: whether to go on until cancelled.

    Raises:
        DemoFailed: a process did not start, or ended too early.
    """
    async with Processes(setting.site.folder / "log") as processes:
        conductor = Conductor(
            speed=setting.speed,
            ros1=setting.arm_ros == 1,
            secure=setting.site.secure,
            say=say,
            check=processes.check,
            finished=finished,
            until_looped=not setting.loop_rule,
        )
        hall = _Hall(setting, processes, conductor)
        await hall.start_infrastructure()
        started()
        with first_failure():
            async with hall.launch.connect() as client, asyncio.TaskGroup() as tasks:
                tasks.create_task(conductor.follow(client, stay=stay))
                await hall.start_robots()
