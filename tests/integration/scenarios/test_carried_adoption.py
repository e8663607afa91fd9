"""Carried runs one of whose bridges is off for good: another one goes on, and may be off later, too."""

from __future__ import annotations

import asyncio
import signal
from typing import Any

import pytest

from tests.integration.scenarios.carried_runs import THREE, leave_out, mutual, reason_of, run_carried, told_by
from tests.integration.scenarios.conftest import Plant, all_heard, call, run_is, says, texts, value
from tests.integration.server_model.harness import until


@pytest.mark.parametrize("plant", ["automatic"], indirect=True)
async def test_another_bridge_goes_on_for_one_that_is_off_and_that_one_parks_what_it_has(plant: Plant) -> None:
    mutual(plant)

    def soon(raw: dict[str, Any]) -> None:
        raw["scenarios"] = {"adopt_after_s": 2.0}

    plant.declare(soon)
    plant.scenario("three", THREE.replace("work: two", "work: two, seconds: 1"))
    async with plant.server():
        bridges = {robot: plant.bridge(robot) for robot in plant.machines}
        async with plant.client() as client:
            await all_heard(client)
            run_id = await run_carried(client, "three")
            await until(lambda: told_by(plant), lambda told: ("middle", "two") in told, timeout_s=60)
            bridges["middle"].process.send_signal(signal.SIGKILL)
            await asyncio.to_thread(bridges["middle"].process.wait)
            early = await call(client, "Scenarios", "Adopt", run_id, "middle_cell", True, texts())
            assert early.status == 3
            assert "can be left out after 2 s" in early.message
            await until(
                lambda: reason_of(client, run_id), lambda said: f"adopt {run_id} middle_cell" in said, timeout_s=60
            )
            unsure = await call(client, "Scenarios", "Adopt", run_id, "middle_cell", False, texts())
            assert unsure.status == 3
            called = await call(client, "Scenarios", "Adopt", run_id, "middle_cell", True, texts())
            assert called.status == 0, called.message
            assert called.outputs == ["left_cell"]
            state = await run_is(client, run_id, "done", "failed", "aborted")
            assert state == "done", await value(client, f"Scenarios.Runs.{run_id}.Reason")
            told = plant.told()
            assert told[:2] == [("left", "one"), ("middle", "two")]
            assert [work for _, work in told[2:]] == ["two", "two"]
            assert told[2][0] in ("left", "right")
            assert told[3][0] == "right"
            late = plant.bridge("middle")
            await says(late, "asks whether its tokens were adopted")
            await says(late, "of a carried run is parked")
            assert plant.told() == told
            again = await run_carried(client, "three")
            assert await run_is(client, again, "done", "failed", "aborted") == "done"
            assert ("middle", "two") in plant.told()[4:]


@pytest.mark.parametrize("plant", ["automatic"], indirect=True)
async def test_the_heir_of_a_bridge_is_off_too_and_the_last_one_goes_on(plant: Plant) -> None:
    mutual(plant)

    def soon(raw: dict[str, Any]) -> None:
        raw["scenarios"] = {"adopt_after_s": 2.0}

    plant.declare(soon)
    plant.scenario("three", THREE.replace("work: two", "work: two, seconds: 4"))
    plant.users()
    server = plant.server_process()
    bridges = {robot: plant.bridge(robot) for robot in plant.machines}
    async with plant.client() as client:
        await all_heard(client)
        run_id = await run_carried(client, "three")
        await until(lambda: told_by(plant), lambda told: len(told) == 2, timeout_s=60)
        await leave_out(client, run_id, "middle", bridges["middle"], "left_cell")
        await until(lambda: told_by(plant), lambda told: len(told) == 3, timeout_s=60)
        await leave_out(client, run_id, "left", bridges["left"], "right_cell")
    server.process.send_signal(signal.SIGKILL)
    await asyncio.to_thread(server.process.wait)
    plant.server_process()
    async with plant.client() as client:
        state = await run_is(client, run_id, "done", "failed", "aborted")
        assert state == "done", await reason_of(client, run_id)
    told = plant.told()
    assert told[:2] == [("left", "one"), ("middle", "two")]
    assert {work for _, work in told[2:]} == {"two"}
    assert told[-1][0] == "right"


@pytest.mark.parametrize("knows", ["old", "new"])
@pytest.mark.parametrize("plant", ["automatic"], indirect=True)
async def test_another_bridge_goes_on_for_one_that_is_taken_out_of_the_file(plant: Plant, knows: str) -> None:
    """The server is started with the new file; and the heir, too, or it has the one with which the run began."""
    mutual(plant)

    def soon(raw: dict[str, Any]) -> None:
        raw["scenarios"] = {"adopt_after_s": 2.0}

    def without_middle(raw: dict[str, Any]) -> None:
        del raw["bridges"]["middle_cell"], raw["robots"]["middle"]
        for bridge in raw["bridges"].values():
            bridge["requestors"] = [0, 300, 302]

    plant.declare(soon)
    plant.scenario("three", THREE.replace("work: two", "work: two, seconds: 4"))
    plant.users()
    server = plant.server_process()
    bridges = {robot: plant.bridge(robot) for robot in plant.machines}
    async with plant.client() as client:
        await all_heard(client)
        run_id = await run_carried(client, "three")
        await until(lambda: told_by(plant), lambda told: len(told) == 2, timeout_s=60)
    stopped = [server, bridges["middle"], *([bridges["left"]] if knows == "new" else [])]
    for child in stopped:
        child.process.send_signal(signal.SIGKILL)
        await asyncio.to_thread(child.process.wait)
    plant.declare(without_middle)
    plant.server_process()
    if knows == "new":
        plant.bridge("left")
    async with plant.client() as client:
        wanted = f"have another bridge go on: ua-fleet scenario adopt {run_id} 'space 301' --off"
        said = await until(lambda: reason_of(client, run_id), lambda said: wanted in said, timeout_s=60)
        assert "space 301: it is not in fleet.yaml any more" in said
        assert list(await value(client, f"Scenarios.Runs.{run_id}.Bridges"))[1] == "space 301"
        assert list(await value(client, f"Scenarios.Runs.{run_id}.BridgeStates"))[1] == "silent"
        called = await call(client, "Scenarios", "Adopt", run_id, "space 301", True, texts())
        assert called.status == 0, called.message
        assert called.outputs == ["left_cell"]
        state = await run_is(client, run_id, "done", "failed", "aborted")
        assert state == "done", await reason_of(client, run_id)
    told = plant.told()[2:]
    assert [work for _, work in told] == ["two", "two"], "begun again by another robot, and then the third one"
    assert told[0][0] in ("left", "right")
    assert told[1][0] == "right"


@pytest.mark.parametrize("plant", ["automatic"], indirect=True)
async def test_a_run_is_aborted_without_a_bridge_that_is_taken_out_of_the_file(plant: Plant) -> None:
    mutual(plant)

    def without_middle(raw: dict[str, Any]) -> None:
        del raw["bridges"]["middle_cell"], raw["robots"]["middle"]
        for bridge in raw["bridges"].values():
            bridge["requestors"] = [0, 300, 302]

    plant.scenario("three", THREE.replace("work: two", "work: two, seconds: 4"))
    plant.users()
    server = plant.server_process()
    bridges = {robot: plant.bridge(robot) for robot in plant.machines}
    async with plant.client() as client:
        await all_heard(client)
        run_id = await run_carried(client, "three")
        await until(lambda: told_by(plant), lambda told: len(told) == 2, timeout_s=60)
    for child in (server, bridges["middle"]):
        child.process.send_signal(signal.SIGKILL)
        await asyncio.to_thread(child.process.wait)
    plant.declare(without_middle)
    plant.server_process()
    async with plant.client() as client:
        await until(lambda: reason_of(client, run_id), lambda said: f"scenario abort {run_id}" in said, timeout_s=60)
        assert (await call(client, "Scenarios", "Abort", run_id, "enough")).status == 0
        assert await run_is(client, run_id, "done", "failed", "aborted") == "aborted"
        assert "space 301 did not know it" in await reason_of(client, run_id)
