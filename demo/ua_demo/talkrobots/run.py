"""The nine tasks on one machine: server, ROS master, bridges and robots as processes beside the conductor."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial

from ua_demo.launch import START_TIMEOUT_S, Launch
from ua_demo.lines import read_line
from ua_demo.processes import Processes
from ua_demo.result import DemoResult
from ua_demo.talkrobots.chooser import Ask
from ua_demo.talkrobots.conductor import Conductor
from ua_demo.talkrobots.setting import ACTORS, Setting
from ua_fleet.config.load import load

__all__ = ["run_talkrobots"]


class _Hall:
    """The processes."""

    def __init__(self, setting: Setting, processes: Processes) -> None:
        self._setting, self._processes = setting, processes
        self.launch = Launch(setting.site, processes)
        self.traffic = setting.site.folder / "traffic"
        self._ready: set[str] = set()
        self._changed = asyncio.Event()

    async def start(self) -> None:
        """Start everything, and wait until each process is ready."""
        setting, launch = self._setting, self.launch
        self.traffic.mkdir(exist_ok=True)
        for old in self.traffic.iterdir():
            old.unlink()
        await launch.prepare()
        await launch.broker()
        if setting.has_ros1:
            await launch.master()
        await launch.server(*self._log("server"))
        for actor in ACTORS:
            await launch.bridge(actor.bridge, setting.bridge_ros(actor), *self._log(actor.bridge))
        for actor in ACTORS:
            heard = partial(self._robot_says, actor.name)
            await self._processes.start(actor.name, setting.command(actor), setting.environment(actor), heard)
        await launch.console()
        await launch.ready("server", *(actor.bridge for actor in ACTORS))
        names = {actor.name for actor in ACTORS}
        await self._processes.until(lambda: names <= self._ready, self._changed, START_TIMEOUT_S, "the robots")

    def _log(self, name: str) -> tuple[str, ...]:
        return ("--traffic-log", str(self.traffic / f"{name}.jsonl"))

    def _robot_says(self, name: str, line: str) -> None:
        event = read_line(line)
        if line.partition(":")[0] == "ready" or (event is not None and event.what == "is ready"):
            self._ready.add(name)
            self._changed.set()


async def run_talkrobots(
    setting: Setting,
    *,
    say: Callable[[str], None],
    ask: Ask,
    started: Callable[[], None],
    finished: Callable[[DemoResult], None],
    wait: bool,
    stay: bool,
) -> None:
    """Run the nine tasks once; with `stay` keep everything up afterwards until cancelled.

    Args:
        setting: site, speed, who chooses.
        say: prints a line of the timeline.
        ask: has an operator choose.
        started: called once the fleet is complete and clients can run scenarios.
        finished: called with the result of each run.
        wait: run nothing, but wait until a client does.
        stay: whether to go on until cancelled.

    Raises:
        DemoFailed: a process did not start, ended too early, or the run does not end.
    """
    log = setting.site.folder / "log"
    async with Processes(log) as processes:
        hall = _Hall(setting, processes)
        await hall.start()
        conductor = Conductor(
            load(setting.site.config_file),
            speed=setting.speed,
            mode=setting.mode,
            traffic=lambda: hall.traffic.glob("*.jsonl"),
            say=say,
            ask=ask,
            check=processes.check,
            started=started,
            finished=finished,
            runs=not wait,
            patience_s=START_TIMEOUT_S,
            remedy=f"see the logs in {log}",
            is_carried=setting.is_carried,
        )
        async with hall.launch.connect() as client:
            await conductor.follow(client, stay=stay)
