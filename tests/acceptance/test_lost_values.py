"""Robots whose values are lost while their SkillStatus is not. What machines were told is the proof.

The program that tells a robot's values ends; the one that does its skills works, and its bridge too. By its values the
robot is Offline: nobody begins beside it what it says it is at, and nobody asks it for anything new meanwhile.
"""

from __future__ import annotations

import asyncio
import signal
from typing import Any

import pytest
from asyncua.client.client import Client

from tests.acceptance.conftest import Works, reason_of, state_of
from tests.acceptance.test_killed_bridges import task, told
from tests.integration.scenarios.conftest import ROBOTS, all_heard, call, run, run_is
from tests.integration.server_model.harness import until

SILENCE_S = 2.0
pytestmark = pytest.mark.parametrize("works", ["automatic"], indirect=True)


async def is_offline(client: Client, robot: str, *, offline: bool = True) -> None:
    """Wait until the server shows a robot as Offline, or not."""

    async def read() -> Any:
        return await client.get_node(f"ns=2;s=Robots.{robot}.State").read_value()

    await until(read, lambda state: (state == 0) is offline, timeout_s=60)


def prepare(works: Works, steps: str) -> None:
    """A fleet in which everything wants a second robot as soon as nobody knows what the first one is at."""
    works.configure(silence_s=SILENCE_S, limit_s=60.0)
    works.tell_values("left")
    works.scenario("one", steps)


async def test_a_robot_whose_values_are_lost_within_a_task_has_nobody_begin_beside_it(works: Works) -> None:
    prepare(works, task("a", "left", 6 * SILENCE_S, on_unknown="replace") + task("b", "left", 0.0))
    for robot in ROBOTS:
        works.bridge(robot)
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        await told(works, ("left", "a"))
        works.machines["left"].mute(is_mute=True)
        await is_offline(client, "left")
        await asyncio.sleep(2 * SILENCE_S)
        assert works.told() == [("left", "a")]
        assert await state_of(client, run_id) == ["accepted"]
        works.machines["left"].mute(is_mute=False)
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
        assert works.told() == [("left", "a"), ("left", "b")]


async def test_its_task_is_done_when_it_says_so_and_what_follows_goes_to_who_is_heard(works: Works) -> None:
    prepare(works, task("a", "left", SILENCE_S + 1.5, on_unknown="replace") + task("b", "left", 0.0))
    for robot in ROBOTS:
        works.bridge(robot)
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        await told(works, ("left", "a"))
        works.machines["left"].mute(is_mute=True)
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
        assert works.told() == [("left", "a"), ("middle", "b")]


async def test_a_bridge_that_is_killed_too_leaves_nobody_who_says_what_its_robot_is_at(works: Works) -> None:
    prepare(works, task("a", "left", 8 * SILENCE_S, on_unknown="replace"))
    bridges = {robot: works.bridge(robot) for robot in ROBOTS}
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        await told(works, ("left", "a"))
        works.machines["left"].mute(is_mute=True)
        await is_offline(client, "left")
        await asyncio.sleep(SILENCE_S)
        bridges["left"].end(signal.SIGKILL)
        await asyncio.sleep(0.5 * SILENCE_S)
        assert works.told() == [("left", "a")], "it is waited for from the kill on"
        await told(works, ("left", "a"), ("middle", "a"))
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)


@pytest.mark.parametrize("is_back", [True, False])
async def test_a_robot_whose_values_are_lost_before_its_task_is_waited_for(works: Works, *, is_back: bool) -> None:
    """It stands, as far as anybody knows, so that waiting harms nobody; and what it would begin with is not of now."""
    prepare(works, "  - {wait: null, event: go}\n" + task("a", "left", 0.0, on_unknown="replace"))
    for robot in ROBOTS:
        works.bridge(robot)
    async with works.server() as server, server.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        works.machines["left"].mute(is_mute=True)
        await is_offline(client, "left")
        assert (await call(client, "Scenarios", "TellEvent", "go")).status == 0
        await asyncio.sleep(0.5 * SILENCE_S)
        assert works.told() == []
        works.machines["left"].mute(is_mute=not is_back)
        assert await run_is(client, run_id, "done", "failed") == "done", await reason_of(client, run_id)
        assert works.told() == [("left" if is_back else "middle", "a")]
