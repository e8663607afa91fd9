"""Runs that bridges carry: a whole server, three bridges as processes, real UDP."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import Any

import pytest

from tests.integration.scenarios.carried_runs import THREE, mutual, reason_of, run_carried, told_by
from tests.integration.scenarios.conftest import Plant, all_heard, call, open_decision, run_is, texts, value
from tests.integration.server_model.harness import until
from tests.system import Processes

FORKED = """
  - {task: first, skill: work, robot: left, arguments: {work: one}}
  - parallel:
      - [{task: a, skill: work, robot: middle, arguments: {work: a}}]
      - - {task: b, skill: work, robot: right, arguments: {work: b}}
        - {task: c, skill: work, robot: left, arguments: {work: c}}
  - if: c.seconds >= 0
    then: [{task: last, skill: work, robot: middle, arguments: {work: last}}]
    else: [{task: never, skill: work, robot: middle, arguments: {work: never}}]
"""


ROUNDS = """
  - {task: first, skill: work, robot: left, arguments: {work: first, seconds: 2}}
  - repeat:
      - parallel:
          - - {task: a, skill: work, robot: middle, arguments: {work: a, seconds: 0.3}}
            - {task: b, skill: work, robot: left, arguments: {work: b}}
          - [{task: c, skill: work, robot: right, after: [a], arguments: {work: "=a.done"}}]
      - if: right.level > 0.5
        then: [{task: d, skill: work, robot: left, arguments: {work: d}}]
        else: [{task: never, skill: work, robot: middle, arguments: {work: never}}]
    times: 3
    while: first.seconds > 1
  - {task: last, skill: work, robot: right, arguments: {work: "=b.done"}}
"""
ROUND = [("middle", "a"), ("left", "b"), ("right", "a"), ("left", "d")]
"""What is done in each; the middle two side by side."""


async def test_a_run_goes_from_bridge_to_bridge(plant: Plant) -> None:
    mutual(plant)
    plant.scenario("three", THREE)
    plant.scenario("forked", FORKED)
    async with plant.server():
        for robot in plant.machines:
            plant.bridge(robot)
        async with plant.client() as client:
            await all_heard(client)
            run_id = await run_carried(client, "three")
            assert await run_is(client, run_id, "done", "failed", "aborted") == "done"
            assert plant.told() == [("left", "one"), ("middle", "two"), ("right", "two")]
            assert await value(client, f"Scenarios.Runs.{run_id}.Robots") == ["left", "middle", "right"]

            run_id = await run_carried(client, "forked")
            state = await run_is(client, run_id, "done", "failed", "aborted")
            assert state == "done", await value(client, f"Scenarios.Runs.{run_id}.Reason")
            told = plant.told()[3:]
            assert told[0] == ("left", "one")
            assert told[-1] == ("middle", "last")
            assert set(told[1:-1]) == {("middle", "a"), ("right", "b"), ("left", "c")}


async def test_the_server_is_killed_and_a_new_one_shows_the_whole_run(plant: Plant) -> None:
    mutual(plant)
    slow = THREE.replace("work: one", "work: one, seconds: 6")
    plant.scenario("three", slow)
    plant.users()
    server = plant.server_process()
    for robot in plant.machines:
        plant.bridge(robot)
    async with plant.client() as client:
        await all_heard(client)
        run_id = await run_carried(client, "three")

        async def begun() -> bool:
            return plant.told() == [("left", "one")]

        await until(begun, bool, timeout_s=60)
    server.process.send_signal(signal.SIGKILL)
    await asyncio.to_thread(server.process.wait)

    async def all_told() -> list[tuple[str, str]]:
        return plant.told()

    done = [("left", "one"), ("middle", "two"), ("right", "two")]
    await until(all_told, lambda told: told == done, timeout_s=60)
    plant.server_process()
    async with plant.client() as client:
        assert await run_is(client, run_id, "done", "failed", "aborted") == "done"
        states = await value(client, f"Scenarios.Runs.{run_id}.States")
        assert states == ["done", "done", "done"]
    assert plant.told() == done


async def test_rounds_branches_and_conditions_over_bridges_go_on_without_the_server(plant: Plant) -> None:
    mutual(plant)

    def level(raw: dict[str, Any]) -> None:
        raw["robots"]["right"]["data"] = {"level": {"id": 1301, "type": "Double"}}

    plant.declare(level)
    plant.scenario("rounds", ROUNDS)
    plant.users()
    server = plant.server_process()
    for robot in plant.machines:
        plant.bridge(robot)
    async with plant.client() as client:
        await all_heard(client)
        run_id = await run_carried(client, "rounds")
        await until(lambda: told_by(plant), bool, timeout_s=60)
    server.process.send_signal(signal.SIGKILL)
    await asyncio.to_thread(server.process.wait)
    told = await until(lambda: told_by(plant), lambda told: len(told) == 14, timeout_s=60)
    assert (told[0], told[13]) == (("left", "first"), ("right", "b"))
    for start in (1, 5, 9):
        found = told[start : start + 4]
        assert sorted(found) == sorted(ROUND)
        assert (found[0], found[3]) == (ROUND[0], ROUND[3]), "a before the others, and d after them"
    plant.server_process()
    async with plant.client() as client:
        state = await run_is(client, run_id, "done", "failed", "aborted")
        assert state == "done", await reason_of(client, run_id)
        steps = await value(client, f"Scenarios.Runs.{run_id}.Steps")
        assert len(steps) == len(set(steps)) == 14, steps
    assert plant.told() == told


async def test_a_bridge_that_dies_with_the_token_goes_on_after_its_restart(plant: Plant) -> None:
    mutual(plant)
    plant.scenario("three", THREE.replace("work: two", "work: two, seconds: 2"))
    async with plant.server():
        bridges = {robot: plant.bridge(robot) for robot in plant.machines}
        async with plant.client() as client:
            await all_heard(client)
            run_id = await run_carried(client, "three")

            async def begun() -> bool:
                return ("middle", "two") in plant.told()

            await until(begun, bool, timeout_s=60)
            bridges["middle"].process.send_signal(signal.SIGKILL)
            await asyncio.to_thread(bridges["middle"].process.wait)
            bridges["right"].process.send_signal(signal.SIGKILL)
            await asyncio.to_thread(bridges["right"].process.wait)
            plant.bridge("middle")
            await until(
                lambda: reason_of(client, run_id), lambda found: "its token is kept here" in found, timeout_s=60
            )
            plant.bridge("right")
            state = await run_is(client, run_id, "done", "failed", "aborted")
            assert state == "done", await value(client, f"Scenarios.Runs.{run_id}.Reason")
            assert plant.told() == [("left", "one"), ("middle", "two"), ("right", "two")]


async def test_nothing_begins_unless_every_bridge_has_its_part(plant: Plant) -> None:
    mutual(plant)
    plant.scenario("three", THREE)
    async with plant.server():
        children = {robot: plant.bridge(robot) for robot in plant.machines}
        async with plant.client() as client:
            await all_heard(client)
            child = children["right"]
            child.process.send_signal(signal.SIGKILL)
            await asyncio.to_thread(child.process.wait)
            run_id = await run_carried(client, "three")
            states = "done", "failed", "aborted"
            await until(lambda: reason_of(client, run_id), lambda found: "right_cell" in found, timeout_s=60)
            plant.bridge("right")
            assert await run_is(client, run_id, *states) == "failed"
            reason = await value(client, f"Scenarios.Runs.{run_id}.Reason")
            assert "right_cell" in reason, reason
            assert plant.told() == []


async def test_an_abort_halts_what_is_under_way_and_ends_the_run_everywhere(plant: Plant) -> None:
    mutual(plant)
    plant.scenario("three", THREE.replace("work: one", "work: one, seconds: 30"))
    async with plant.server():
        for robot in plant.machines:
            plant.bridge(robot)
        async with plant.client() as client:
            await all_heard(client)
            run_id = await run_carried(client, "three")

            async def begun() -> bool:
                return plant.told() == [("left", "one")]

            await until(begun, bool, timeout_s=60)
            called = await call(client, "Scenarios", "Run", "other", texts(), texts())
            assert called.status != 0
            called = await call(client, "Scenarios", "Abort", run_id, "enough")
            assert called.status == 0, called.message
            assert await run_is(client, run_id, "done", "failed", "aborted") == "aborted"
            again = await run_carried(client, "three")
            await until(lambda: told_by(plant), lambda told: len(told) == 2, timeout_s=60)
            await call(client, "Scenarios", "Abort", again, "enough")
            assert await run_is(client, again, "aborted") == "aborted"


async def test_a_run_is_paused_at_every_bridge_and_goes_on(plant: Plant) -> None:
    mutual(plant)
    plant.scenario("three", THREE.replace("work: one", "work: one, seconds: 3"))
    plant.users()
    server = plant.server_process()
    bridges = {robot: plant.bridge(robot) for robot in plant.machines}
    async with plant.client() as client:
        await all_heard(client)
        run_id = await run_carried(client, "three")
        await until(lambda: told_by(plant), bool, timeout_s=60)
        assert await run_is(client, run_id, "running") == "running"  # the server may hear of it after the robot's begin
        bridges["right"].process.send_signal(signal.SIGKILL)
        await asyncio.to_thread(bridges["right"].process.wait)
        called = await call(client, "Scenarios", "Pause", run_id)
        assert called.status == 0, called.message
        assert await value(client, f"Scenarios.Runs.{run_id}.State") == "paused"
        await until(lambda: reason_of(client, run_id), lambda said: "right_cell" in said, timeout_s=60)
        plant.bridge("right")
        await until(lambda: reason_of(client, run_id), lambda said: said == "", timeout_s=60)

        async def ended() -> str:
            (state,) = await value(client, f"Scenarios.Runs.{run_id}.States")
            return str(state)

        assert await until(ended, lambda state: state == "done", timeout_s=60) == "done"
        assert plant.told() == [("left", "one")]
    server.process.send_signal(signal.SIGKILL)
    await asyncio.to_thread(server.process.wait)
    plant.server_process()
    async with plant.client() as client:
        assert await value(client, f"Scenarios.Runs.{run_id}.State") == "paused"
        called = await call(client, "Scenarios", "Resume", run_id)
        assert called.status == 0, called.message
        assert await run_is(client, run_id, "done", "failed", "aborted") == "done"
        assert plant.told() == [("left", "one"), ("middle", "two"), ("right", "two")]
        called = await call(client, "Scenarios", "Pause", run_id)
        assert called.status != 0


async def test_who_takes_over_is_chosen_through_the_server(plant: Plant) -> None:
    mutual(plant)
    plant.scenario("three", THREE.replace("work: two", "work: heavy"))
    plant.machines["middle"].weaken()
    async with plant.server():
        for robot in plant.machines:
            plant.bridge(robot)
        async with plant.client() as client:
            await all_heard(client)
            run_id = await run_carried(client, "three")
            decision = await open_decision(client)
            path = f"Resilience.Decisions.{decision}"
            # The server has heard all robots; the bridge that asks ranks those that it has heard itself.
            await until(
                lambda: value(client, f"{path}.Robots"), lambda robots: robots == ["left", "right"], timeout_s=60
            )
            assert sum(await value(client, f"{path}.Scores")) == pytest.approx(1)
            assert f"decision confirm {decision}" in await reason_of(client, run_id)
            nobody = await call(client, "Resilience", "Confirm", decision, "middle")
            assert nobody.status == 3
            assert "middle_cell" in nobody.message
            assert "cannot take over" in nobody.message
            called = await call(client, "Resilience", "Confirm", decision, "left")
            assert called.status == 0, called.message
            assert called.outputs == ["taken"]
            assert await run_is(client, run_id, "done", "failed", "aborted") == "done"
            assert plant.told()[2:] == [("left", "heavy"), ("right", "heavy")]
            assert await value(client, f"{path}.State") == "chosen"
            again = await call(client, "Resilience", "Confirm", decision, "left")
            assert again.outputs == ["repeated"]


async def test_an_answer_that_no_bridge_takes_is_refused_with_their_reasons(plant: Plant) -> None:
    mutual(plant)
    plant.scenario("three", THREE.replace("work: one", "work: one, seconds: 30"))
    async with plant.server():
        for robot in plant.machines:
            plant.bridge(robot)
        async with plant.client() as client:
            await all_heard(client)
            run_id = await run_carried(client, "three")
            await until(lambda: told_by(plant), bool, timeout_s=60)
            called = await call(client, "Scenarios", "Answer", run_id, "first", "done")
            assert called.status == 3
            assert "no bridge of the run has taken it" in called.message
            for robot in plant.machines:
                assert f"{robot}_cell" in called.message
            await call(client, "Scenarios", "Abort", run_id, "seen enough")


async def test_why_a_scenario_cannot_be_carried(plant: Plant) -> None:
    plant.scenario("three", THREE)
    steps = "\n  - {task: first, skill: work, robot: left}\n  - {wait: , event: go}\n  - if: left.go_on > 0"
    steps += "\n    then: [{task: a, skill: work, robot: middle}]\n    else: [{task: b, skill: work, robot: right}]\n"
    plant.scenario("mixed", steps)
    async with plant.server(), plant.client() as client:
        called = await call(client, "Scenarios", "ValidateCarried", "mixed")
        assert called.outputs[0] is False
        told = "\n".join(called.outputs[1])
        for said in ("'go'", "left.go_on"):
            assert said in told
        assert "bridges" not in told, "steps of several bridges are carried"
        called = await call(client, "Scenarios", "ValidateCarried", "three")
        assert any("requestors" in problem for problem in called.outputs[1])
        called = await call(client, "Scenarios", "RunCarried", "three", texts(), texts())
        assert called.status == 2
        assert "requestors" in called.message


@pytest.mark.parametrize("plant", ["automatic"], indirect=True)
async def test_another_bridges_robot_stands_in_without_the_server(plant: Plant) -> None:
    mutual(plant)
    steps = THREE.replace("work: two", "work: heavy, seconds: 1")
    plant.scenario("three", steps.replace("work: one", "work: one, seconds: 2"))
    plant.machines["middle"].weaken()
    plant.users()
    server = plant.server_process()
    for robot in plant.machines:
        plant.bridge(robot)
    async with plant.client() as client:
        await all_heard(client)
        run_id = await run_carried(client, "three")
        await until(lambda: told_by(plant), lambda told: told == [("left", "one")], timeout_s=60)
    server.process.send_signal(signal.SIGKILL)
    await asyncio.to_thread(server.process.wait)
    told = await until(lambda: told_by(plant), lambda told: len(told) == 4, timeout_s=60)
    assert told[1] == ("middle", "heavy")
    assert told[2] in (("left", "heavy"), ("right", "heavy"))
    assert told[3] == ("right", "heavy"), "the third task says what the second one has done"
    plant.server_process()
    async with plant.client() as client:
        assert await run_is(client, run_id, "done", "failed", "aborted") == "done"
        robots = await value(client, f"Scenarios.Runs.{run_id}.Robots")
        assert robots == ["left", told[2][0], "right"]


async def test_words_of_carried_runs_are_signed_and_encrypted(
    tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes
) -> None:
    pubsub = {"security": "sign_and_encrypt", "keys": {"source": "files"}}
    plant = Plant(tmp_path, udp_url, tcp_port, processes, "operator", pubsub)
    mutual(plant)
    plant.scenario("three", THREE)
    await plant.prepare()
    async with plant.server():
        for robot in plant.machines:
            plant.bridge(robot)
        async with plant.client() as client:
            await all_heard(client)
            run_id = await run_carried(client, "three")
            state = await run_is(client, run_id, "done", "failed", "aborted")
            assert state == "done", await value(client, f"Scenarios.Runs.{run_id}.Reason")
            assert plant.told() == [("left", "one"), ("middle", "two"), ("right", "two")]


async def test_a_robot_of_a_carried_run_does_nothing_else_for_anybody(plant: Plant) -> None:
    mutual(plant)
    plant.scenario("three", THREE.replace("work: one", "work: one, seconds: 4"))
    plant.scenario("other", "\n  - {task: only, skill: work, robot: right, arguments: {work: other}}\n")
    async with plant.server():
        for robot in plant.machines:
            plant.bridge(robot)
        async with plant.client() as client:
            await all_heard(client)
            run_id = await run_carried(client, "three")
            await until(lambda: told_by(plant), bool, timeout_s=60)
            called = await call(client, "Scenarios", "Run", "other", texts(), texts())
            other: str = called.outputs[0]
            await until(lambda: reason_of(client, other), lambda found: "reserved" in found, timeout_s=60)
            assert await run_is(client, run_id, "done", "failed", "aborted") == "done"
            assert await run_is(client, other, "done", "failed", "aborted") == "done"
            assert plant.told()[-2:] == [("right", "two"), ("right", "other")]
