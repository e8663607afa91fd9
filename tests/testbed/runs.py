"""Runs that are under way when a bridge or the server is killed: each is done, and its robots begin each task once."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from tests.testbed.disturb import Deed, disturbance
from tests.testbed.engine import Container
from tests.testbed.ledger import Begun
from tests.testbed.watching import Watcher
from tests.testbed.words import begun_in
from ua_fleet.client.scenarios import RunInfo, ScenarioClient
from ua_fleet.errors import UaFleetError

__all__ = ["CASES", "RunCase", "RunRow", "problems_of", "run_lines", "through_kills"]

LIMIT_S: Final = 90.0
"""A run goes on by itself within this, or needs help."""
_CONDUCTOR: Final = "tasks"
_CONTROLLERS: Final = ("ur3", "conveyor")
_KILL_AFTER: Final = 2
"""Tasks of a robot that are done when the container is killed."""
_LOOK_S: Final = 0.1

_STEPS: Final[Mapping[str, Sequence[str]]] = {
    "ridgeback": ("skill: fetch, robot: ridgeback, arguments: {table: table, to: table}",) * 6,
    "pioneer_1": tuple(
        f"skill: go, robot: pioneer_1, arguments: {{to: {to}}}" for to in ("conveyor", "table", "conveyor", "table")
    ),
    "ur3": tuple(f"skill: pick, robot: ur3, arguments: {{angle: {angle}}}" for angle in (10, -10, 20, -20, 30, -30)),
    "conveyor": tuple(f"skill: transport, robot: conveyor, arguments: {{distance: {mm}}}" for mm in range(401, 407)),
    "drone": ("skill: take_off, robot: drone", "skill: land, robot: drone") * 3,
}
"""What a run has a robot do, one after the other. Each can tell a bridge that is started anew what became of it."""
_NEEDS_VALUE: Final = "if: temperature_sensor.temperature > -40, then: {wait: 0.1}, else: {end: failed, reason: cold}"


@dataclass(frozen=True, slots=True)
class RunCase:
    """Who is killed while which robots work in a run."""

    service: str
    robots: tuple[str, ...]
    last: str = ""
    """A step at the end."""

    def text(self) -> str:
        """The scenario."""
        lines = ["version: 1", f"name: run_{self.service.replace('-', '_')}", "steps:", "  - parallel:"]
        for robot in self.robots:
            tasks = [f"{{task: {robot}_{number}, {step}}}" for number, step in enumerate(_STEPS[robot])]
            lines.append(f"      - [{', '.join(tasks)}]")
        lines.append("      - {wait: 0.1}")  # side by side are two at least
        if self.last:
            lines.append(f"  - {{{self.last}}}")
        return "\n".join([*lines, ""])

    def wanted(self) -> dict[str, int]:
        """How many tasks each robot has."""
        return {robot: len(_STEPS[robot]) for robot in self.robots}


CASES: Final = (
    RunCase("server", tuple(_STEPS)),
    RunCase("ridgeback-bridge", ("ridgeback",)),
    RunCase("pioneer-1-bridge", ("pioneer_1",)),
    RunCase("ur3-bridge", ("ur3",)),
    RunCase("conveyor-bridge", ("conveyor",)),
    RunCase("drone-bridge", ("drone",)),
    RunCase("temperature-sensor-bridge", ("drone",), _NEEDS_VALUE),
)


@dataclass(frozen=True, slots=True)
class RunRow:
    """What became of a run."""

    service: str
    state: str
    reason: str
    was_under_way: bool
    """When the container was killed."""
    took_s: float
    """From the kill to its end."""
    tasks: Mapping[str, int]
    begun: Sequence[Begun] = field(default_factory=tuple[Begun, ...])
    """By its robots, while it was under way."""


def problems_of(row: RunRow) -> list[str]:
    """What is not as it has to be, one line each."""
    found = [] if row.state == "done" else [f"a run is {row.state} after the kill of {row.service}: {row.reason}"]
    if not row.was_under_way:
        found.append(f"a run was {row.state} before {row.service} was killed")
    begun = Counter(one.robot for one in row.begun if one.robot in row.tasks)
    for robot, wanted in row.tasks.items():
        if begun[robot] != wanted:
            found.append(f"a run in which {row.service} was killed: {robot} has {wanted} tasks, began {begun[robot]}")
    return found


def run_lines(rows: Iterable[RunRow]) -> list[str]:
    """A table in Markdown."""
    made = ["| killed within a run | the run is | after | tasks | begun |", "|---|---|---:|---:|---:|"]
    for row in rows:
        begun = sum(one.robot in row.tasks for one in row.begun)
        made.append(f"| `{row.service}` | {row.state} | {row.took_s:.1f} s | {sum(row.tasks.values())} | {begun} |")
    return made


async def through_kills(
    watcher: Watcher, containers: dict[str, Container], cases: Sequence[RunCase] = CASES
) -> list[RunRow]:
    """Kill each of the cases within a run, one after the other."""
    return [await _through_kill(watcher, containers, case) for case in cases]


async def _through_kill(watcher: Watcher, containers: dict[str, Container], case: RunCase) -> RunRow:
    since = time.time()
    run_id = await ScenarioClient(await watcher.connected()).run(case.text())
    before = await _shown(watcher, run_id, lambda run: run.is_over or min(_done(run, case).values()) >= _KILL_AFTER)
    act = await asyncio.to_thread(disturbance, Deed.KILL, containers[case.service])
    killed = time.time()
    await asyncio.to_thread(act.begin)
    await asyncio.to_thread(act.end)
    run = await _shown(watcher, run_id, lambda run: run.is_over)
    took_s = time.time() - killed
    if not run.is_over:
        await ScenarioClient(await watcher.connected()).abort(run_id, "it takes too long")
    begun = await asyncio.to_thread(begun_in, containers, _CONDUCTOR, _CONTROLLERS, since, time.time())
    shown = zip(run.tasks, run.states, strict=True)
    waits = "; ".join(f"{task} is {state}" for task, state in shown if state != "done")
    return RunRow(case.service, run.state, run.reason or waits, not before.is_over, took_s, case.wanted(), begun)


def _done(run: RunInfo, case: RunCase) -> dict[str, int]:
    done = dict.fromkeys(case.robots, 0)
    for task, state in zip(run.tasks, run.states, strict=True):
        robot = task.rpartition("_")[0]
        if robot in done:
            done[robot] += state == "done"
    return done


async def _shown(watcher: Watcher, run_id: str, expected: Callable[[RunInfo], bool]) -> RunInfo:
    """The run once it is as expected, or as it is after LIMIT_S; over any number of connections."""
    deadline = time.monotonic() + LIMIT_S
    last: RunInfo | None = None
    while last is None or (not expected(last) and time.monotonic() < deadline):
        # No connection, or its columns are of two moments.
        with contextlib.suppress(UaFleetError, ValueError):
            last = await ScenarioClient(await watcher.connected()).run_info(run_id)
        await asyncio.sleep(_LOOK_S)
    return last
