"""Runs the nine tasks: server, ROS master, bridges and robots as processes, commanded as any OPC UA client does."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from ua_fleet.client import DecisionTold, FleetClient, NotDone, RunTold, ScenarioClient, StepTold, Told
from ua_fleet.config.load import load
from ua_fleet.demo.launch import START_TIMEOUT_S, Launch
from ua_fleet.demo.lines import read_line
from ua_fleet.demo.processes import DemoFailed, Processes
from ua_fleet.demo.talkrobots.costs import Costs, cost_lines
from ua_fleet.demo.talkrobots.course import Course
from ua_fleet.demo.talkrobots.setting import ACTORS, SCENARIO, Setting
from ua_fleet.errors import UaFleetError
from ua_fleet.storage.traffic_log import read_traffic

__all__ = ["Ask", "TalkRobotsResult", "run_talkrobots"]

BROKEN: Final = "ridgeback"
REPAIRED_DURING: Final = "bring"
REPAIR_S: Final = 1.0
"""The demonstration's seconds from the start of that task, which another robot does, until Ridgeback is repaired."""
RUN_TIMEOUT_S: Final = 600.0
"""The demonstration's seconds after which a run is given up that nobody has to decide about; one takes about 120."""
LOOK_S: Final = 0.2
REST_S: Final = 1.0
"""After the end of a run its last answers are still under way."""

Ask = Callable[[DecisionTold], Awaitable[str | None]]
"""Has an operator choose a robot; None where nobody is there. Cancelled when somebody else has decided."""


@dataclass(slots=True)
class TalkRobotsResult:
    """How a run ended: what goes into the JSON file, what is printed, and whether it was as it should be."""

    report: dict[str, Any]
    lines: list[str]
    problems: list[str] = field(default_factory=list[str])


class _Demonstration:
    def __init__(
        self, setting: Setting, processes: Processes, tasks: asyncio.TaskGroup, say: Callable[[str], None], ask: Ask
    ) -> None:
        self._setting, self._processes, self._tasks = setting, processes, tasks
        self._say, self._ask = say, ask
        self._launch = Launch(setting.site, processes)
        self._traffic = setting.site.folder / "traffic"
        self._ready: set[str] = set()
        self._changed = asyncio.Event()
        self._asking: asyncio.Task[None] | None = None
        self._is_first = True
        self._config = load(setting.site.config_file)
        self._units = {name: criterion.unit for name, criterion in self._config.resilience.criteria.items()}

    # The processes.

    async def start(self) -> None:
        """Start everything, and wait until each process is ready."""
        setting, launch = self._setting, self._launch
        self._traffic.mkdir(exist_ok=True)
        await launch.prepare()
        if setting.has_ros1:
            await launch.master()
        await launch.server(*self._log("server"))
        for actor in ACTORS:
            await launch.bridge(actor.bridge, setting.bridge_ros(actor), *self._log(actor.bridge))
        for actor in ACTORS:
            heard = partial(self._robot_says, actor.name)
            environment = setting.environment(actor)
            await self._processes.start(actor.name, setting.command(actor), environment, heard, stdin=actor.stdin)
        await launch.ready("server", *(actor.bridge for actor in ACTORS))
        names = {actor.name for actor in ACTORS}
        await self._processes.until(lambda: names <= self._ready, self._changed, START_TIMEOUT_S, "the robots")

    def _log(self, name: str) -> tuple[str, ...]:
        return ("--traffic-log", str(self._traffic / f"{name}.jsonl"))

    def _robot_says(self, name: str, line: str) -> None:
        event = read_line(line)
        if line.partition(":")[0] == "ready" or (event is not None and event.what == "is ready"):
            self._ready.add(name)
            self._changed.set()

    def connect(self) -> AbstractAsyncContextManager[FleetClient]:
        """A client of the user."""
        return self._launch.connect()

    async def until_heard(self, client: FleetClient) -> None:
        """Wait until the server hears all robots, with all of their values."""
        deadline = time.monotonic() + START_TIMEOUT_S
        while missing := await self._not_heard(client):
            self._processes.check()
            if time.monotonic() > deadline:
                log = self._setting.site.folder / "log"
                raise DemoFailed(f"the server does not hear {', '.join(missing)}; see the logs in {log}")
            await asyncio.sleep(LOOK_S)

    async def _not_heard(self, client: FleetClient) -> list[str]:
        addresses = [(robot, f"ns=2;s=Robots.{robot}.State") for robot in self._config.robots]
        for name, robot in self._config.robots.items():
            for data in robot.data.values():
                fields = [f"ns=2;s={data.id}.{field}" for field in data.fields or ()]
                addresses += [(name, address) for address in fields or [f"ns=2;i={data.id}"]]
        readings = await client.read([address for _, address in addresses])
        silent = {
            robot: None
            for (robot, address), reading in zip(addresses, readings, strict=True)
            if reading.status or (address.endswith(".State") and not reading.value)
        }
        return list(silent)

    # Runs.

    async def follow(
        self,
        client: FleetClient,
        told: AsyncIterator[Told],
        finished: Callable[[TalkRobotsResult], None],
        *,
        wait: bool,
        stay: bool,
    ) -> None:
        """Run the scenario, or wait until somebody does; then with `stay` go on with whatever is run."""
        scenarios = ScenarioClient(client)
        course: Course | None = None
        deadline: float | None = None
        if not wait:
            problems = await scenarios.validate(SCENARIO)
            if problems:
                raise DemoFailed(f"{SCENARIO}: " + "; ".join(problem.text for problem in problems))
            course = Course(await scenarios.run(SCENARIO), self._setting.speed, self._units)
            if self._setting.mode == "automatic":
                deadline = time.monotonic() + RUN_TIMEOUT_S / self._setting.speed
        while True:
            try:
                async with asyncio.timeout(LOOK_S):
                    one = await anext(told)
            except TimeoutError:
                self._processes.check()
                if deadline is not None and time.monotonic() > deadline:
                    raise DemoFailed("the run does not end; look with: ua-fleet scenario watch") from None
                continue
            if course is None or course.outcome is not None:
                if not isinstance(one, RunTold) or one.state != "running":
                    continue
                course = Course(one.run_id, self._setting.speed, self._units)
            for line in course.take(one):
                self._say(line)
            self._act_on(one, scenarios)
            if course.outcome is not None:
                deadline = None
                await asyncio.sleep(REST_S)
                finished(self._result(course))
                if not stay:
                    return

    def _act_on(self, told: Told, scenarios: ScenarioClient) -> None:
        """What people do in the hall: a mechanic repairs, and an operator chooses who takes over."""
        if isinstance(told, StepTold):
            if told.fact == "TaskAssigned" and told.task == REPAIRED_DURING and told.robot != BROKEN:
                delay_s = REPAIR_S / self._setting.speed
                asyncio.get_running_loop().call_later(delay_s, self._processes.write_line, BROKEN, "repair")
        elif isinstance(told, DecisionTold):
            if told.state != "open":
                if self._asking is not None:
                    self._asking.cancel()
                    self._asking = None
            elif self._asking is None and self._setting.mode == "operator":
                self._asking = self._tasks.create_task(self._choose(told, scenarios))

    async def _choose(self, told: DecisionTold, scenarios: ScenarioClient) -> None:
        robot = await self._ask(told)
        if robot is None:
            return
        try:
            await scenarios.confirm(told.decision_id, robot)
        except NotDone as error:
            self._say(f"{'':11}not done: {error}")

    def _result(self, course: Course) -> TalkRobotsResult:
        sent = read_traffic(sorted(self._traffic.glob("*.jsonl")))
        # Starting everything is a part of the first run, as in the paper.
        costs = Costs.of(sent, since=0.0 if self._is_first else course.started_at)
        self._is_first = False
        report = {**course.report(), **costs.report()}
        actors = [row.robot for row in course.rows.values()]
        lines = cost_lines(
            costs,
            robots=len(ACTORS) - 1,
            actors=actors,
            elapsed_s=course.elapsed_s,
            faulty=0 if report["fault"] is None else 1,
        )
        return TalkRobotsResult(report, lines, course.problems)


async def run_talkrobots(
    setting: Setting,
    *,
    say: Callable[[str], None],
    ask: Ask,
    started: Callable[[], None],
    finished: Callable[[TalkRobotsResult], None],
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
    try:
        async with Processes(setting.site.folder / "log") as processes, asyncio.TaskGroup() as tasks:
            demonstration = _Demonstration(setting, processes, tasks, say, ask)
            await demonstration.start()
            async with demonstration.connect() as client, client.told() as told:
                await demonstration.until_heard(client)
                started()
                await demonstration.follow(client, told, finished, wait=wait, stay=stay)
    except ExceptionGroup as group:
        failed, other = group.split(UaFleetError)
        if failed is None or other is not None:
            raise
        raise failed.exceptions[0] from None
