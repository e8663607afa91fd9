"""Robots with faults, and tasks that nobody can do: who is commanded, and who is not."""

from __future__ import annotations

from typing import Any

import pytest
from asyncua.client.client import Client

from tests.acceptance.conftest import Works, reason_of
from tests.integration.scenarios.conftest import ROBOTS, all_heard, call, run, run_is
from tests.integration.scenarios.machines import POISONED
from tests.integration.server_model.harness import until


def task(name: str, who: str, work: str, **keys: str) -> str:
    more = "".join(f", {key}: {text}" for key, text in keys.items())
    return f"  - {{task: {name}, skill: work, {who}, arguments: {{work: {work}}}{more}}}\n"


async def raise_faults(client: Client, *robots: str) -> None:
    for robot in robots:
        assert (await call(client, "Faults", "RaiseFault", robot, "gripper stuck")).status == 0


@pytest.mark.parametrize("works", ["automatic"], indirect=True)
@pytest.mark.parametrize("faulted", [("left", "middle"), ("middle", "left"), ("left", "right")])
async def test_two_robots_have_faults_and_a_run_names_one_of_them(works: Works, faulted: tuple[str, str]) -> None:
    """Also over a restart of the server, which tells all faults before the first step."""
    works.scenario("one", task("a", f"robot: {faulted[0]}", "a") + task("b", f"robot: {faulted[1]}", "b"))
    (fit,) = set(ROBOTS) - set(faulted)
    for robot in ROBOTS:
        works.bridge(robot)
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        await raise_faults(client, *reversed(faulted))  # the one that the first task names is known last
        run_id = await run(client, "one")
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
        assert works.told() == [(fit, "a"), (fit, "b")]
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
        assert works.told() == [(fit, "a"), (fit, "b")] * 2


@pytest.mark.parametrize("works", ["automatic"], indirect=True)
async def test_a_run_whose_robots_have_faults_comes_back_with_the_server_and_asks_none_of_them(works: Works) -> None:
    works.scenario("one", "  - {wait: null, event: go}\n" + task("a", "robot: left", "a"))
    for robot in ROBOTS:
        works.bridge(robot)
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        await raise_faults(client, "left", "middle")
    async with works.server() as server, server.client() as client:
        assert (await call(client, "Scenarios", "TellEvent", "go")).status == 0
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
    assert works.told() == [("right", "a")]


@pytest.mark.parametrize("works", ["automatic"], indirect=True)
@pytest.mark.parametrize("who", ["robot: left", "capacity: weld"])
async def test_a_poisoned_task_leaves_the_fleet_as_it_was(works: Works, who: str) -> None:
    """Three robots in turn fail at it; the run says what each said, and the next run is done by all of them."""
    works.scenario("bad", task("a", who, POISONED))
    works.scenario("good", "".join(task(f"t_{robot}", f"robot: {robot}", "weld") for robot in ROBOTS))
    for robot in ROBOTS:
        works.bridge(robot)
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        bad = await run(client, "bad")
        assert await run_is(client, bad, "done", "failed") == "failed"
        reason = await reason_of(client, bad)
        assert all(f"{robot} cannot hold a part of 1e9 kg" in reason for robot in ROBOTS), reason
        assert sorted(works.told()) == sorted((robot, POISONED) for robot in ROBOTS)
        good = await run(client, "good")
        assert await run_is(client, good, "done", "failed") == "done", await reason_of(client, good)
        assert works.told()[3:] == [(robot, "weld") for robot in ROBOTS]


@pytest.mark.parametrize("works", ["automatic"], indirect=True)
async def test_a_robot_that_fails_where_another_one_does_it_has_a_fault(works: Works) -> None:
    works.scenario("one", task("a", "robot: left", "heavy"))
    works.machines["left"].weaken()
    for robot in ROBOTS:
        works.bridge(robot)
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
        assert works.told() == [("left", "heavy"), ("middle", "heavy")]
        alarm = client.get_node("ns=2;s=Fleet.Faults.left.skill.Message")

        async def said() -> Any:
            return (await alarm.read_value()).Text

        await until(said, lambda text: "and middle has done it" in text)


@pytest.mark.parametrize("works", ["automatic"], indirect=True)
async def test_a_robot_that_lacks_a_capacity_is_given_nothing_that_needs_it(works: Works) -> None:
    """Also after a restart of the server; a fault that names what the robot has not takes everything away."""
    works.scenario("one", task("a", "robot: left", "a") + task("b", "capacity: weld", "b"))
    for robot in ROBOTS:
        works.bridge(robot)
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        assert (await call(client, "Faults", "RaiseFault", "left", "weld: the tip is worn")).status == 0
        assert (await call(client, "Faults", "RaiseFault", "middle", "paint: empty")).status == 0
        alarms = [client.get_node(f"ns=2;s=Fleet.Faults.{robot}.robot.Capacities") for robot in ("left", "middle")]
        assert [list(await alarm.read_value() or ()) for alarm in alarms] == [["weld"], []]
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        alarm = client.get_node("ns=2;s=Fleet.Faults.left.robot.Capacities")
        assert list(await alarm.read_value()) == ["weld"]
        run_id = await run(client, "one")
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
        assert works.told() == [("right", "a"), ("right", "b")]
