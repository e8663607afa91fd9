"""What robots are at, in their summaries: tasks of runs and skills of people, with real bridges."""

from __future__ import annotations

import asyncio
import signal
from typing import Any

from asyncua.client.client import Client

from tests.contract.skilled import ENDLESS_WORK
from tests.integration.scenarios.conftest import Plant, call, run, run_is
from tests.integration.server_model.harness import OBSERVER, OPERATOR, ua, until

OFFLINE, IDLE, BUSY = 0, 1, 2


async def robot(client: Client, name: str) -> Any:
    summaries = await client.get_node("ns=2;s=Fleet.Summaries.1").read_value()
    assert [one.Name for one in summaries] == ["left", "middle", "right"]
    return next(one for one in summaries if one.Name == name)


async def stands(client: Client, name: str, state: int, task: str, run_id: str = "") -> Any:
    return await until(
        lambda: robot(client, name),
        lambda one: (one.State, one.Task, one.RunId) == (state, task, run_id),
        timeout_s=60,
    )


async def test_a_task_of_a_run_is_told_with_its_run_also_after_a_restart(plant: Plant) -> None:
    plant.scenario(
        "two",
        "  - {task: hold_it, skill: work, robot: left, arguments: {seconds: 6}}\n"
        "  - {task: weld_it, skill: work, robot: right}\n",
    )
    for name in ("left", "right"):
        plant.bridge(name)
    async with plant.server() as server, server.client() as client:
        first = await stands(client, "left", IDLE, "")
        assert first.Quality.name == "Good"  # it has no data, and its bridge is there
        assert first.Bridge == "left_cell"
        assert (await robot(client, "middle")).Quality.name != "Good"
        await stands(client, "right", IDLE, "")
        run_id = await run(client, "two")
        await stands(client, "left", BUSY, "hold_it", run_id)
    async with plant.server() as server, server.client(OBSERVER) as client:
        again = await robot(client, "left")
        assert (again.Task, again.RunId) == ("hold_it", run_id)  # its journal says so, from the first moment
        await run_is(client, run_id, "done")
        for name in ("left", "right"):
            await stands(client, name, IDLE, "")


def heard_for_longer(fleet: dict[str, Any]) -> None:
    """A Start is refused while the robot is not heard, which a busy machine brings about within 0.8 s."""
    fleet["pubsub"]["receive_timeout_s"] = 3.0


async def test_a_skill_that_a_person_has_started_is_told_and_a_bridge_that_dies(plant: Plant) -> None:
    plant.declare(heard_for_longer)
    bridge = plant.bridge("left")
    async with plant.server() as server, server.client(OPERATOR) as client:
        await stands(client, "left", IDLE, "")
        work = ua.Variant(ENDLESS_WORK, ua.VariantType.String)
        await client.get_node("ns=2;i=1100").call_method("0:Start", work, ua.Variant(0.0, ua.VariantType.Double))
        await stands(client, "left", BUSY, "work")
        await asyncio.to_thread(bridge.end, signal.SIGKILL)
        gone = await stands(client, "left", OFFLINE, "work")  # nobody has said that it has stopped
        gone = await until(lambda: robot(client, "left"), lambda one: one.Quality.name == "BadNoCommunication")
        assert gone.Task == "work"
        silent = await until(lambda: robot(client, "left"), lambda one: one.Faults == 1, timeout_s=60)
        assert silent.Fault
        called = await call(client, "Faults", "RaiseFault", ua.Variant("left"), ua.Variant("it smokes"))
        assert called.status == 0
        burning = await until(lambda: robot(client, "left"), lambda one: one.Faults == 2)
        assert burning.Fault == "it smokes"
