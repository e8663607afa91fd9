"""Robots that answer twice, late, for another execution or never, and replacements that fail as well."""

from __future__ import annotations

import itertools
import json
from typing import Any

import pytest
from asyncua.client.client import Client

from tests.contract.skilled import ENDLESS_WORK, FAILING_WORK
from tests.integration.scenarios.conftest import (
    ENGINEER,
    ROBOTS,
    Plant,
    all_heard,
    call,
    open_decision,
    run,
    run_is,
    value,
    watching,
)
from tests.integration.scenarios.machines import ANSWERS_FOR_ANOTHER, ANSWERS_TWICE
from ua_fleet.nodes.nodeset import TypeId


def task(name: str, work: str, robot: str = "left", **keys: Any) -> str:
    """A step; `seconds` is an argument, all else are keys of the task."""
    arguments = {"work": work, "seconds": keys.pop("seconds", 0)}
    step = {"task": name, "skill": "work", "robot": robot, "arguments": arguments, **keys}
    return f"  - {json.dumps(step)}\n"


async def tasks(client: Client, run_id: str, column: str) -> dict[str, Any]:
    """What the nodes of a run show of its tasks."""
    names = await value(client, f"Scenarios.Runs.{run_id}.Tasks")
    return dict(zip(names, await value(client, f"Scenarios.Runs.{run_id}.{column}"), strict=True))


@pytest.mark.parametrize("plant", ["abort"], indirect=True)
async def test_answers_that_come_twice_or_late_or_for_another_execution_change_nothing(plant: Plant) -> None:
    plant.scenario("twice", task("a", ANSWERS_TWICE, seconds=0.2) + task("b", "weld"))
    plant.scenario("late", task("a", "weld", seconds=2, timeout_s=0.5) + task("b", "after it"))
    plant.scenario("another", task("a", "weld") + task("b", ANSWERS_FOR_ANOTHER, timeout_s=1.0, on_unknown="fail"))
    plant.bridge("left")
    async with plant.server() as server, server.client() as client:
        state = client.get_node("ns=2;s=1100.CurrentState")

        async def shown() -> Any:
            return (await state.read_value()).Text

        twice = await run(client, "twice")
        assert await run_is(client, twice, "done", "failed") == "done"
        results = await tasks(client, twice, "Results")
        assert json.loads(results["a"]) == {"done": ANSWERS_TWICE, "seconds": 0.2}
        assert await shown() == "Ready"

        late = await run(client, "late")
        assert await run_is(client, late, "done", "failed") == "done"
        assert await shown() == "Ready"
        assert await tasks(client, late, "States") == {"a": "done", "b": "done"}, "it finishes what it has begun"

        another = await run(client, "another")
        assert await run_is(client, another, "done", "failed") == "failed"
        assert await tasks(client, another, "States") == {"a": "done", "b": "failed"}
        assert (
            "not done in 1 s; left did not confirm that it has stopped"
            in (await tasks(client, another, "Messages"))["b"]
        )
        assert json.loads((await tasks(client, another, "Results"))["a"]) == {"done": "weld", "seconds": 0}

        assert await tasks(client, twice, "States") == {"a": "done", "b": "done"}
        assert await value(client, f"Scenarios.Runs.{late}.State") == "done"
    assert [work for _, work in plant.told()] == [
        ANSWERS_TWICE,
        "weld",
        "weld",
        "after it",
        "weld",
        ANSWERS_FOR_ANOTHER,
    ]


NEVER = {"timeout_s": 0.5}


@pytest.mark.parametrize(
    ("plant", "work", "keys", "alarm"),
    [("operator", FAILING_WORK, {}, "work failed: the machine broke"), ("automatic", ENDLESS_WORK, NEVER, "")],
    indirect=["plant"],
)
async def test_replacements_fail_or_never_answer_until_none_is_left(
    plant: Plant, work: str, keys: dict[str, Any], alarm: str
) -> None:
    plant.scenario("hopeless", task("a", work, **keys) + task("b", "never begun"))
    for robot in ROBOTS:
        plant.bridge(robot)
    async with plant.server() as server, server.client() as client:
        await all_heard(client)
        async with watching(client, TypeId.RUN_EVENT, TypeId.DECISION_EVENT, TypeId.FAULT_ALARM) as seen:
            if plant.config.resilience.mode == "operator":
                async with server.client(ENGINEER) as engineer:  # nobody repairs a robot in time
                    assert (await call(engineer, "Resilience", "SetMode", "operator", 4.0, "best")).status == 0
            run_id = await run(client, "hopeless")
            if plant.config.resilience.mode == "operator":
                for robot in ROBOTS[1:]:
                    assert (await call(client, "Resilience", "Confirm", await open_decision(client), robot)).status == 0
            for robot in ROBOTS[1:]:
                await seen.wait_for(f"{robot} takes over")
            ended = await seen.wait_for(f"{run_id}: failed")
        assert (ended.Severity, ended.State) == (700, "failed")
        assert "no robot is left that can take over" in ended.Message.Text
        texts = [event.Message.Text for event in seen.events]
        cure = "when it can work again, run: ua-fleet fault clear"
        alarms = [f"{robot}: {alarm} (BadOutOfService); {cure} {robot}.skill" for robot in ROBOTS] if alarm else []
        assert [text for text in texts if text in alarms] == alarms
        assert plant.told() == [(robot, work) for robot in ROBOTS]

        # Nothing of it hangs, and each robot is there for the next run once its fault is over.
        assert await tasks(client, run_id, "States") == {"a": "failed"}
        decisions = await client.get_node("ns=2;s=Fleet.Resilience.Decisions").get_children()
        assert "open" not in [await (await node.get_child("3:State")).read_value() for node in decisions]
        for robot in ROBOTS if alarm else ():
            assert (await call(client, "Faults", "ClearFault", robot)).status == 0
        following = "".join(task(f"t_{robot}", "next", robot) for robot in ROBOTS)
        run_id = await run(client, f"version: 1\nname: next\nsteps:\n{following}")
        assert await run_is(client, run_id, "done", "failed") == "done"
        assert plant.told()[3:] == [(robot, "next") for robot in ROBOTS]


async def test_runs_that_want_one_robot_are_served_in_the_order_in_which_they_asked(plant: Plant) -> None:
    for name in ("one", "two", "three"):
        plant.scenario(name, task("a", f"{name} a", seconds=0.3) + task("b", f"{name} b", robot="right"))
    for robot in ("left", "right"):
        plant.bridge(robot)
    async with plant.server() as server, server.client() as client:
        run_ids = [await run(client, name) for name in ("one", "two", "three")]
        assert [await run_is(client, run_id, "done", "failed") for run_id in run_ids] == ["done"] * 3
    left = plant.machines["left"].told()
    assert [job.work for job in left] == ["one a", "two a", "three a"]
    assert all(later.began >= job.began + job.seconds for job, later in itertools.pairwise(left))
    assert [work for robot, work in plant.told() if robot == "right"] == ["one b", "two b", "three b"]
    assert plant.told().index(("right", "one b")) < plant.told().index(("left", "three a")), "side by side"
