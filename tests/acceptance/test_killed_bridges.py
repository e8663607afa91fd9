"""Bridges that are killed with SIGKILL while their robots work, or just before. What machines were told is the proof.

The machines go on when their bridge is gone, as real ones do. Nothing of the fleet is configured for the kill.
"""

from __future__ import annotations

import asyncio
import signal
from typing import Any

import pytest
from asyncua.client.client import Client

from tests.acceptance.conftest import Works, reason_of, state_of
from tests.integration.scenarios.conftest import ROBOTS, all_heard, call, open_decision, run, run_is, says, value
from tests.integration.server_model.harness import until
from tests.system import Child

RESTART_S = 0.5


def task(name: str, robot: str, seconds: float, **keys: str) -> str:
    more = "".join(f", {key}: {text}" for key, text in keys.items())
    return f"  - {{task: {name}, skill: work, robot: {robot}, arguments: {{work: {name}, seconds: {seconds}}}{more}}}\n"


async def told(works: Works, *jobs: tuple[str, str]) -> None:
    """Wait until the machines were told this, and nothing else."""

    async def read() -> Any:
        return works.told()

    await until(read, lambda found: found == list(jobs), timeout_s=60)


async def kill_and_restart(works: Works, bridge: Child, robot: str) -> None:
    bridge.end(signal.SIGKILL)
    await asyncio.sleep(RESTART_S)
    await says(works.start_bridge(robot), "ready")


@pytest.mark.parametrize("works", ["operator", "automatic"], indirect=True)
async def test_a_bridge_that_is_killed_within_a_task_and_is_back_has_it_done_once(works: Works) -> None:
    works.scenario("one", task("a", "left", 3.0) + task("b", "left", 0.0))
    bridges = {robot: works.bridge(robot) for robot in ROBOTS}
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        await told(works, ("left", "a"))
        await kill_and_restart(works, bridges["left"], "left")
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
        assert works.told() == [("left", "a"), ("left", "b")]
        assert await faults_of(client, "left") == []


@pytest.mark.parametrize("works", ["operator", "automatic"], indirect=True)
@pytest.mark.parametrize("after_s", [0.0, 0.2, 1.0])
async def test_a_bridge_that_is_killed_just_before_a_task_and_is_back_has_it_done_once(
    works: Works, after_s: float
) -> None:
    works.scenario("one", f"  - {{wait: {0.1 + after_s}}}\n" + task("a", "left", 0.2))
    bridges = {robot: works.bridge(robot) for robot in ROBOTS}
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        await kill_and_restart(works, bridges["left"], "left")
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
        assert works.told() == [("left", "a")]


@pytest.mark.parametrize("works", ["automatic"], indirect=True)
async def test_all_bridges_killed_at_once_and_the_run_goes_on_where_it_was(works: Works) -> None:
    steps = "".join(f"      - [{task(robot, robot, 2.0).strip()[2:]}]\n" for robot in ROBOTS)
    works.scenario("all", f"  - parallel:\n{steps}" + task("last", "right", 0.0))
    bridges = {robot: works.bridge(robot) for robot in ROBOTS}
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "all")

        async def count() -> Any:
            return len(works.told())

        await until(count, lambda found: found == len(ROBOTS))
        await asyncio.gather(*[kill_and_restart(works, bridges[robot], robot) for robot in ROBOTS])
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
        assert sorted(works.told()) == sorted([(robot, robot) for robot in ROBOTS] + [("right", "last")])


@pytest.mark.parametrize("works", ["automatic"], indirect=True)
async def test_a_bridge_that_stays_away_has_nobody_begin_in_its_place(works: Works) -> None:
    """An automatic run ends too: at the limit its task fails, since nobody has consented to a second robot."""
    works.configure(silence_s=2.0, limit_s=2.0)
    works.scenario("one", task("a", "left", 1.0))
    bridges = {robot: works.bridge(robot) for robot in ROBOTS}
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        await told(works, ("left", "a"))
        bridges["left"].end(signal.SIGKILL)
        decision = await open_decision(client)
        assert "left may still be at it" in await value(client, f"Resilience.Decisions.{decision}.Reason")
        assert await run_is(client, run_id, "done", "failed") == "failed"
        assert "nobody consented in time to a second robot" in await reason_of(client, run_id)
        assert works.told() == [("left", "a")]


@pytest.mark.parametrize("works", ["automatic"], indirect=True)
@pytest.mark.parametrize(
    ("on_unknown", "state", "jobs"),
    [
        ("fail", "failed", [("left", "a")]),
        ("replace", "done", [("left", "a"), ("middle", "a")]),
    ],
)
async def test_a_bridge_that_stays_away_and_what_the_author_wants_then(
    works: Works, on_unknown: str, state: str, jobs: list[tuple[str, str]]
) -> None:
    works.configure(silence_s=2.0, limit_s=60.0)
    works.scenario("one", task("a", "left", 2.0, on_unknown=on_unknown))
    bridges = {robot: works.bridge(robot) for robot in ROBOTS}
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        await told(works, ("left", "a"))
        bridges["left"].end(signal.SIGKILL)
        assert await run_is(client, run_id, "done", "failed") == state, await reason_of(client, run_id)
        assert works.told() == jobs


@pytest.mark.parametrize("works", ["automatic"], indirect=True)
@pytest.mark.parametrize("on_unknown", ["retry", "ask"])
async def test_a_bridge_that_is_away_for_longer_than_is_waited_for_tells_when_it_is_back(
    works: Works, on_unknown: str
) -> None:
    works.configure(silence_s=1.0, limit_s=60.0)
    works.scenario("one", task("a", "left", 2.0, on_unknown=on_unknown, retries="2"))
    bridges = {robot: works.bridge(robot) for robot in ROBOTS}
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        await told(works, ("left", "a"))
        bridges["left"].end(signal.SIGKILL)
        waiting = "lost" if on_unknown == "retry" else "asked"

        async def states() -> Any:
            return await state_of(client, run_id)

        await until(states, lambda found: found == [waiting], timeout_s=60)
        await says(works.start_bridge("left"), "ready")
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
        assert works.told() == [("left", "a")], "it was done, and the robot can tell"


@pytest.mark.parametrize("works", ["automatic"], indirect=True)
async def test_a_robot_that_is_away_before_its_task_is_replaced_once_it_was_waited_for(works: Works) -> None:
    works.configure(silence_s=2.0, limit_s=60.0)
    works.scenario("one", task("a", "left", 0.0))
    for robot in ROBOTS[1:]:
        works.bridge(robot)
    async with works.server() as server, server.client() as client:
        run_id = await run(client, "one")
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
        assert works.told() == [("middle", "a")]
        assert (await call(client, "Faults", "ClearFault", "right")).status == 0


async def faults_of(client: Client, robot: str) -> list[str]:
    """The sources of a robot's faults that are active."""
    found: list[str] = []
    for node in await client.get_node("ns=2;s=Fleet.Faults").get_children():
        name = (await node.read_browse_name()).Name
        owner, _, source = name.partition(".")
        if owner == robot and source and await value(client, f"Faults.{name}.ActiveState.Id"):
            found.append(source)
    return found
