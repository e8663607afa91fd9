"""Has the tasks of a scenario done and watches them, as any OPC UA client does, wherever the fleet's processes run."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterable
from pathlib import Path
from typing import Final

from ua_demo.failing import first_failure
from ua_demo.processes import DemoFailed
from ua_demo.result import DemoResult
from ua_demo.talkrobots.chooser import Ask, Chooser
from ua_demo.talkrobots.costs import Costs, cost_lines
from ua_demo.talkrobots.course import TASKS, Course
from ua_demo.talkrobots.setting import ACTORS, SCENARIO, Mode
from ua_fleet.client import (
    DecisionTold,
    FleetClient,
    NodeNotFound,
    RunTold,
    ScenarioClient,
    Told,
)
from ua_fleet.config.schema import FleetConfig
from ua_fleet.storage.traffic_log import read_traffic

__all__ = ["Conductor"]

RUN_TIMEOUT_S: Final = 600.0
"""The demonstration's seconds after which a run is given up that nobody has to decide about; one takes about 120."""
LOOK_S: Final = 0.2
SAY_S: Final = 10.0
"""After so long it is said who is waited for."""
REST_S: Final = 1.0
"""After the end of a run its last answers are still under way."""


class Conductor:
    """One for all connections: a run goes on while the server is away, and is followed again when it is back."""

    def __init__(
        self,
        config: FleetConfig,
        *,
        speed: float,
        mode: Mode,
        traffic: Callable[[], Iterable[Path]] | None,
        say: Callable[[str], None],
        ask: Ask,
        check: Callable[[], None],
        started: Callable[[], None],
        finished: Callable[[DemoResult], None],
        runs: bool,
        patience_s: float,
        remedy: str = "",
        scenario: str = SCENARIO,
        tasks: int = TASKS,
        is_carried: bool = False,
    ) -> None:
        """Prepare for any number of connections.

        Args:
            config: of the fleet.
            speed: how many times faster than in the paper.
            mode: who chooses a replacement.
            traffic: the files in which processes write down what they send, which is held against the paper; None: it
                is not.
            say: prints a line of the timeline.
            ask: has an operator choose.
            check: raises where going on makes no sense; looked at now and then.
            started: called once the fleet is complete.
            finished: called with the result of each run.
            runs: run the scenario once; otherwise wait until somebody does.
            patience_s: longest wait for the fleet to be complete.
            remedy: what people are told to do after that.
            scenario: its name on the server.
            tasks: how many it has.
            is_carried: whether bridges carry the run.
        """
        self._scenario, self._tasks, self._is_carried = scenario, tasks, is_carried
        self._config, self._speed, self._mode, self._traffic = config, speed, mode, traffic
        self._say, self._check = say, check
        self._started, self._finished = started, finished
        self._is_to_run, self._patience_s, self._remedy = runs, patience_s, remedy
        self._units = {name: criterion.unit for name, criterion in config.resilience.criteria.items()}
        self._course: Course | None = None
        self._is_complete = False
        self._is_first = True
        self._deadline: float | None = None
        self._chooser = Chooser(ask, say)

    async def follow(self, client: FleetClient, *, stay: bool) -> None:
        """Run the scenario, or wait until somebody does, and follow it to its end; with `stay` go on with the next.

        Raises:
            DemoFailed: the fleet is not complete in time, the scenario has mistakes, or the run does not end.
            UaFleetError: the connection was lost. Where there is another one, this is to be called again.
        """
        with first_failure():
            async with asyncio.TaskGroup() as tasks, client.told() as told:
                if not self._is_complete:
                    await self._until_heard(client)
                    self._is_complete = True
                    self._started()
                scenarios = ScenarioClient(client)
                await self._begin_or_go_on(scenarios, tasks)
                try:
                    await self._follow(scenarios, told, tasks, stay=stay)
                finally:
                    self._chooser.stop()

    # Before a run.

    async def _until_heard(self, client: FleetClient) -> None:
        """Wait until the server hears all robots, with all of their values."""
        begun, said = time.monotonic(), 0
        while missing := await self._not_heard(client):
            self._check()
            waited_s = time.monotonic() - begun
            if waited_s > self._patience_s:
                raise DemoFailed(f"the server does not hear {', '.join(missing)}; {self._remedy}")
            if waited_s // SAY_S > said:
                said = int(waited_s // SAY_S)
                self._say(f"waiting for {', '.join(missing)}")
            await asyncio.sleep(LOOK_S)

    async def _not_heard(self, client: FleetClient) -> list[str]:
        addresses = [(robot, f"ns=2;s=Robots.{robot}.State") for robot in self._config.robots]
        for name, robot in self._config.robots.items():
            for data in robot.data.values():
                if data.origin == "server":
                    continue  # what clients write is told by no robot
                fields = [f"ns=2;s={data.id}.{field}" for field in data.fields or ()]
                addresses += [(name, address) for address in fields or [f"ns=2;i={data.id}"]]
        readings = await client.read([address for _, address in addresses])
        silent = {
            robot: None
            for (robot, address), reading in zip(addresses, readings, strict=True)
            if reading.status or (address.endswith(".State") and not reading.value)
        }
        return list(silent)

    async def _begin_or_go_on(self, scenarios: ScenarioClient, tasks: asyncio.TaskGroup) -> None:
        """Start the run, or take in what has become of one that was under way without us."""
        if self._course is None and self._is_to_run:
            under_way = [run for run in await scenarios.runs() if run.scenario == self._scenario and not run.is_over]
            if not under_way:
                await self._start(scenarios)
                return
            self._course = self._new_course(under_way[0].run_id)
        course = self._course
        if course is None:
            return
        try:
            info = await scenarios.run_info(course.run_id)
        except NodeNotFound:
            self._say(f"the server knows nothing of run {course.run_id} any more")
            self._course = None
            return
        decisions = await scenarios.decisions()
        for line in course.catch_up(info, decisions, time.time()):
            self._say(line)
        for decision in decisions:
            if decision.state == "open" and self._mode == "operator":
                self._chooser.choose(decision.decision_id, decision.robots, scenarios, tasks)

    async def _start(self, scenarios: ScenarioClient) -> None:
        problems = await scenarios.validate(self._scenario, carried=self._is_carried)
        if problems:
            raise DemoFailed(f"{self._scenario}: " + "; ".join(problem.text for problem in problems))
        self._course = self._new_course(await scenarios.run(self._scenario, carried=self._is_carried))
        if self._mode == "automatic":
            self._deadline = time.monotonic() + RUN_TIMEOUT_S / self._speed

    def _new_course(self, run_id: str) -> Course:
        self._is_to_run = False
        return Course(run_id, self._speed, self._units, self._tasks)

    # During a run.

    async def _follow(
        self,
        scenarios: ScenarioClient,
        told: AsyncIterator[Told],
        tasks: asyncio.TaskGroup,
        *,
        stay: bool,
    ) -> None:
        while True:
            if self._course is not None and self._course.outcome is not None:
                await asyncio.sleep(REST_S)
                self._finished(self._result(self._course))
                self._course = self._deadline = None
                if not stay:
                    return
            try:
                async with asyncio.timeout(LOOK_S):
                    one = await anext(told)
            except TimeoutError:
                self._check()
                if self._deadline is not None and time.monotonic() > self._deadline:
                    raise DemoFailed("the run does not end; look with: ua-fleet scenario watch") from None
            else:
                self._take(one, scenarios, tasks)

    def _take(self, one: Told, scenarios: ScenarioClient, tasks: asyncio.TaskGroup) -> None:
        """Take in what was told, and have somebody choose where that is wanted."""
        if self._course is None:
            if not isinstance(one, RunTold) or one.state != "running":
                return
            self._course = self._new_course(one.run_id)
        for line in self._course.take(one):
            self._say(line)
        if isinstance(one, DecisionTold):
            if one.state != "open":
                self._chooser.stop()
            elif self._mode == "operator":
                robots = [place.robot for place in one.ranking.ranked]
                self._chooser.choose(one.decision_id, robots, scenarios, tasks)

    # After a run.

    def _result(self, course: Course) -> DemoResult:
        if self._traffic is None:
            done = sum(row.state == "done" for row in course.rows.values())
            lines = [f"{done} of {self._tasks} tasks were done in {course.elapsed_s:.1f} s"]
            return DemoResult(course.report(), lines, course.problems)
        sent = read_traffic(sorted(self._traffic()))
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
        return DemoResult(report, lines, course.problems)
