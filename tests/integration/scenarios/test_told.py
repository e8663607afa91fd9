"""The typed client is told what happens, with a real server."""

from __future__ import annotations

import asyncio

import pytest

from tests.contract.skilled import ENDLESS_WORK
from tests.integration.scenarios.conftest import ENGINEER, ROBOTS, Plant, all_heard, value
from tests.integration.server_model.harness import OPERATOR
from ua_fleet.client import (
    ClientIdentity,
    DecisionTold,
    FaultTold,
    FleetClient,
    NotDone,
    ScenarioClient,
    StepTold,
    Told,
)


@pytest.mark.parametrize("plant", ["automatic"], indirect=True)
async def test_the_client_is_told_of_runs_steps_faults_and_rankings(plant: Plant) -> None:
    plant.scenario(
        "told",
        "  - {task: first, skill: work, robot: left}\n"
        f"  - {{task: long, skill: work, robot: left, arguments: {{work: {ENDLESS_WORK}}}, timeout_s: 60}}\n",
    )
    for robot in ROBOTS:
        plant.bridge(robot)
    seen: list[Told] = []
    async with plant.server() as server, server.client() as raw:
        await all_heard(raw)
        identity = ClientIdentity(server.folder / "identity")
        user, password = OPERATOR
        async with (
            FleetClient.connect(server.url, user=user, password=password, identity=identity) as client,
            client.told() as told,
            asyncio.timeout(60),
        ):
            run_id = await ScenarioClient(client).run("told")
            async for one in told:
                seen.append(one)
                if isinstance(one, StepTold):
                    if (one.fact, one.task, one.robot) == ("TaskAccepted", "long", "left"):
                        await raw.get_node("ns=2;s=Fleet.Faults").call_method("3:RaiseFault", "left", "stuck")
                    elif (one.fact, one.task, one.robot) == ("TaskAccepted", "long", "middle"):
                        break
    assert {one.run_id for one in seen if not isinstance(one, FaultTold)} == {run_id}
    begun = [(one.task, one.robot) for one in seen if isinstance(one, StepTold) and one.fact == "TaskAssigned"]
    assert begun == [("first", "left"), ("long", "left"), ("long", "middle")]
    times = [one.at for one in seen if isinstance(one, StepTold)]
    assert times == sorted(times)
    (fault,) = [one for one in seen if isinstance(one, FaultTold)]
    assert (fault.robot, fault.source, fault.reason, fault.active) == ("left", "robot", "stuck", True)
    chosen = next(one for one in seen if isinstance(one, DecisionTold) and one.state == "chosen")
    assert (chosen.task, chosen.failed, chosen.chosen, chosen.chosen_by) == ("long", "left", "middle", "automatic")
    ranking = chosen.ranking
    assert ranking.criteria == ("availability",)
    assert ranking.weights == (1.0,)
    assert [place.robot for place in ranking.ranked] == ["middle", "right"]
    assert all(place.raw == (100.0,) and place.scores == (0.5,) for place in ranking.ranked)
    assert ranking.excluded == (("left", "has a fault: stuck"),)


async def test_an_engineer_says_how_replacements_are_chosen(plant: Plant) -> None:
    async with plant.server() as server, server.client() as raw:
        identity = ClientIdentity(server.folder / "identity")
        user, password = ENGINEER
        async with FleetClient.connect(server.url, user=user, password=password, identity=identity) as client:
            scenarios = ScenarioClient(client)
            await scenarios.set_mode("operator", limit_s=7.5, on_limit="abort")
            assert await value(raw, "Resilience.Mode") == "operator"
            assert await value(raw, "Resilience.Limit") == 7500
            assert await value(raw, "Resilience.OnLimit") == "abort"
            assert await scenarios.set_judgements({}) == {"availability": 1.0}
            with pytest.raises(NotDone, match="battery"):
                await scenarios.set_judgements({"battery/distance": 2})
