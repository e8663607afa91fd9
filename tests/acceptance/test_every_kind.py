"""A robot of every kind: kills, faults and a poisoned task. What the robots themselves write down is the proof."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Iterator
from typing import Any, Final

import pytest
from asyncua.client.client import Client

from tests import system
from tests.acceptance.conftest import reason_of
from tests.acceptance.every_kind import ROBOTS, EveryKind, Ledger
from tests.integration.scenarios.conftest import call, run, run_is, value
from tests.integration.server_model.harness import until

pytestmark = [pytest.mark.needs("ros1", "ros2", "ur"), pytest.mark.timeout(300)]

RESTART_S: Final = 0.5
POISONED: Final = -1


def job_of(robot: str, batch: int, tenths: int = 0) -> int:
    """A number that no other job has; its last two digits say how long it takes."""
    return batch * 10_000 + ROBOTS.index(robot) * 100 + tenths


def task(name: str, who: str, job: int, skill: str = "work") -> str:
    return f"{{task: {name}, skill: {skill}, {who}, arguments: {{job: {job}}}}}"


def each(batch: int, tenths: int, arm_tenths: int | None = None) -> str:
    """A step in which each robot does a job of its own, all at once."""
    lasts = dict.fromkeys(ROBOTS, tenths) | {"arm": tenths if arm_tenths is None else arm_tenths}
    lines = [
        f"      - [{task(f'{robot}_{batch}', f'robot: {robot}', job_of(robot, batch, lasts[robot]))}]"
        for robot in ROBOTS
    ]
    return "\n".join(["  - parallel:", *lines, ""])


def faulted(batch: int) -> str:
    """Tasks that name the two that have a fault."""
    return "".join(f"  - {task(robot, f'robot: {robot}', job_of(robot, batch))}\n" for robot in ("press", "ur5"))


SCENARIOS: Final = {
    # Actionlib shows a goal that has ended for 5 s: the arm is still at it when its bridge is back.
    "bridges_within": each(1, 60, arm_tenths=99) + each(2, 0),
    "bridges_between": each(3, 0) + "  - {wait: null, event: go_on}\n" + each(4, 1),
    "server_within": each(5, 40) + each(6, 0),
    "all_between": each(7, 0) + "  - {wait: null, event: go_on}\n" + each(8, 1),
    "faulted": faulted(10),
    "faulted_again": faulted(11),
    "lift": (
        f"  - {task('lift', 'robot: press', job_of('press', 12), 'lift')}\n"
        f"  - {task('weld', 'robot: press', job_of('press', 13))}\n"
    ),
    "poisoned": f"  - {task('poisoned', 'capacity: weld', POISONED)}\n",
    "after": each(14, 1),
}


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EveryKind]:
    """All kinds at work, once for all tests of this file."""
    with system.Processes() as processes, system.ros_domain() as domain:
        plant = EveryKind(tmp_path_factory.mktemp("plant"), processes, domain, SCENARIOS)
        asyncio.run(plant.prepare())
        try:
            plant.begin()
            yield plant
        finally:
            plant.end()


@pytest.fixture(autouse=True)
async def _as_if_alone(plant: EveryKind) -> None:
    """What a test has left that failed costs the next one nothing."""
    await plant.mend()


class Seen:
    """What robots have done since this was made."""

    def __init__(self, plant: EveryKind) -> None:
        self._plant, self._before = plant, {robot: len(lines) for robot, lines in plant.ledger().items()}

    def lines(self) -> Ledger:
        return {robot: lines[self._before[robot] :] for robot, lines in self._plant.ledger().items()}

    async def all_are_at(self, *jobs: int) -> None:
        """Wait until each robot is at its job."""

        async def read() -> Any:
            return [lines[-1:] for lines in self.lines().values()]

        await until(read, lambda found: found == [[f"begun {job}"] for job in jobs], timeout_s=60)


def once(*jobs: int) -> list[str]:
    """One after the other, and each once."""
    return [line for job in jobs for line in (f"begun {job}", f"done {job}")]


async def all_work(client: Client) -> None:
    """Wait until the server hears all robots, and has no fault of any."""

    async def read() -> Any:
        return [await client.get_node(f"ns=2;s=Robots.{robot}.State").read_value() for robot in ROBOTS]

    await until(read, lambda states: set(states) == {1}, timeout_s=60)


async def announced(client: Client, robot: str, *capacities: str) -> None:
    """Wait until the server shows a fault that the robot has announced, and what it takes away."""
    alarms = client.get_node("ns=2;s=Fleet.Faults")

    async def read() -> Any:
        names = [(await node.read_browse_name()).Name for node in await alarms.get_children()]
        if f"{robot}.announced" not in names or not await value(client, f"Faults.{robot}.announced.ActiveState.Id"):
            return None
        return tuple(await value(client, f"Faults.{robot}.announced.Capacities") or ())

    await until(read, lambda found: found == capacities, timeout_s=60)


async def is_done(client: Client, run_id: str, asked: Iterable[str] = ()) -> set[str]:
    """Wait until a run is done; a person tells the truth of those that cannot be asked. Those who were asked for."""
    may_be_asked, answered = set(asked), set[str]()
    names = ("Steps", "Tasks", "States", "State")
    columns = [client.get_node(f"ns=2;s=Fleet.Scenarios.Runs.{run_id}.{name}") for name in names]

    async def read() -> Any:
        steps, tasks, states, state = await client.read_values(columns)
        if not len(steps) == len(tasks) == len(states):
            return None  # a server may do other things between two values of one Read
        for step, name, shown in zip(steps, tasks, states, strict=True):
            if shown == "asked":
                robot = name.partition("_")[0]
                assert robot in may_be_asked, f"{robot} can tell what became of its task"
                if (await call(client, "Scenarios", "Answer", run_id, step, "done")).status == 0:
                    answered.add(robot)
        return state

    state = await until(read, lambda found: found in ("done", "failed", "aborted"), timeout_s=90)
    assert state == "done", await reason_of(client, run_id)
    return answered


async def between(client: Client, run_id: str, seen: Seen, batch: int) -> None:
    """Wait until all robots have done their first job, and the run knows it: it hears of no event before."""

    async def read() -> Any:
        return seen.lines()

    await until(read, lambda lines: lines == {robot: once(job_of(robot, batch)) for robot in ROBOTS}, timeout_s=60)
    states = client.get_node(f"ns=2;s=Fleet.Scenarios.Runs.{run_id}.States")
    await until(states.read_value, lambda found: found.count("done") == len(ROBOTS), timeout_s=60)


async def test_all_bridges_are_killed_within_tasks(plant: EveryKind) -> None:
    """Each robot goes on, and has done each of its tasks once. The box alone cannot tell."""
    first = {robot: job_of(robot, 1, 99 if robot == "arm" else 60) for robot in ROBOTS}
    async with plant.client() as client:
        await all_work(client)
        seen = Seen(plant)
        run_id = await run(client, "bridges_within")
        await seen.all_are_at(*first.values())
        plant.kill_bridges(*ROBOTS)
        await asyncio.sleep(RESTART_S)
        await plant.restart_bridges(*ROBOTS)
        asked = await is_done(client, run_id, {"box", "arm"})
    assert "box" in asked
    assert seen.lines() == {robot: once(first[robot], job_of(robot, 2)) for robot in ROBOTS}


async def test_all_bridges_are_killed_between_tasks(plant: EveryKind) -> None:
    async with plant.client() as client:
        await all_work(client)
        seen = Seen(plant)
        run_id = await run(client, "bridges_between")
        await between(client, run_id, seen, 3)
        plant.kill_bridges(*ROBOTS)

        async def go_on() -> None:
            """No bridge is there yet, and a slow machine has all of them there within the 10 s that an order holds."""
            assert (await call(client, "Scenarios", "TellEvent", "go_on")).status == 0

        await plant.restart_bridges(*ROBOTS, begun=go_on)
        assert await is_done(client, run_id) == set()
    assert seen.lines() == {robot: once(job_of(robot, 3), job_of(robot, 4, 1)) for robot in ROBOTS}


async def test_the_server_is_killed_within_tasks(plant: EveryKind) -> None:
    async with plant.client() as client:
        await all_work(client)
        seen = Seen(plant)
        run_id = await run(client, "server_within")
        await seen.all_are_at(*[job_of(robot, 5, 40) for robot in ROBOTS])
    plant.kill_server()
    await plant.restart_server()
    async with plant.client() as client:
        assert await is_done(client, run_id) == set()
    assert seen.lines() == {robot: once(job_of(robot, 5, 40), job_of(robot, 6)) for robot in ROBOTS}


async def test_server_and_bridges_are_killed_between_tasks(plant: EveryKind) -> None:
    async with plant.client() as client:
        await all_work(client)
        seen = Seen(plant)
        run_id = await run(client, "all_between")
        await between(client, run_id, seen, 7)
    plant.kill_server()
    plant.kill_bridges(*ROBOTS)
    await plant.restart_server()
    await plant.restart_bridges(*ROBOTS)
    async with plant.client() as client:
        assert (await call(client, "Scenarios", "TellEvent", "go_on")).status == 0
        assert await is_done(client, run_id) == set()
    assert seen.lines() == {robot: once(job_of(robot, 7), job_of(robot, 8, 1)) for robot in ROBOTS}


async def test_two_robots_say_that_they_have_a_fault(plant: EveryKind) -> None:
    """Others do what is theirs, also when the server is killed and has to go by what it remembers and hears."""
    async with plant.client() as client:
        await all_work(client)
        seen = Seen(plant)
        with plant.fault_of_press("the gripper is stuck"), plant.open_gate():
            await announced(client, "press")
            await announced(client, "ur5")
            assert await is_done(client, await run(client, "faulted")) == set()
            plant.kill_server()
            await plant.restart_server()
            async with plant.client() as another:
                assert await is_done(another, await run(another, "faulted_again")) == set()
    lines = seen.lines()
    assert (lines["press"], lines["ur5"]) == ([], [])
    jobs = [job_of(robot, batch) for batch in (10, 11) for robot in ("press", "ur5")]
    assert sorted(line for robot in ROBOTS for line in lines[robot]) == sorted(once(*jobs))


async def test_a_robot_says_that_one_of_its_capacities_is_gone(plant: EveryKind) -> None:
    """It does what needs another one, and nothing that needs this one."""
    async with plant.client() as client:
        await all_work(client)
        seen = Seen(plant)
        with plant.fault_of_press("weld: the tip is worn"):
            await announced(client, "press", "weld")
            assert await is_done(client, await run(client, "lift")) == set()
    lines = seen.lines()
    assert lines["press"] == once(job_of("press", 12))
    assert sorted(line for lines_of in lines.values() for line in lines_of) == sorted(
        once(job_of("press", 12), job_of("press", 13))
    )


async def test_a_poisoned_task_is_refused_by_each_and_leaves_all_as_they_were(plant: EveryKind) -> None:
    async with plant.client() as client:
        await all_work(client)
        seen = Seen(plant)
        run_id = await run(client, "poisoned")
        assert await run_is(client, run_id, "done", "failed") == "failed"
        reason = await reason_of(client, run_id)
        assert seen.lines() == {robot: [f"refused {POISONED}"] for robot in ROBOTS}
        assert all(robot in reason for robot in ROBOTS), reason
        assert "the belt is too short" in reason
        await all_work(client)
        assert await is_done(client, await run(client, "after")) == set()
    expected = {robot: [f"refused {POISONED}", *once(job_of(robot, 14, 1))] for robot in ROBOTS}
    assert seen.lines() == expected
