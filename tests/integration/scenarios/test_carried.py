"""Runs that bridges carry: a whole server, three bridges as processes, real UDP."""

from __future__ import annotations

import asyncio
import signal

import pytest

from tests.integration.scenarios.conftest import Plant, all_heard, call, run_is, says, texts, value
from tests.integration.server_model.harness import until

THREE = """
  - {task: first, skill: work, robot: left, arguments: {work: one}}
  - {task: second, skill: work, robot: middle, arguments: {work: two}}
  - {task: third, skill: work, robot: right, arguments: {work: "=second.done"}}
"""
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


def mutual(plant: Plant) -> None:
    """Let all bridges send each other Actions."""

    def change(raw: dict) -> None:
        for bridge in raw["bridges"].values():
            bridge["requestors"] = [0, 300, 301, 302]

    plant.declare(change)


async def run_carried(client, name: str) -> str:
    called = await call(client, "Scenarios", "RunCarried", name, texts(), texts())
    assert called.status == 0, called.message
    run_id: str = called.outputs[0]
    return run_id


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
