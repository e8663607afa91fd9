"""A foreign OPC UA client, node-opcua, looks after alarms and answers dialogs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.scenarios.conftest import ROBOTS, Plant, all_heard, call, run, run_is, value
from tests.integration.server_model.harness import OPERATOR, SPEED, fleet_config, reader, serving, until
from tests.integration.server_model.test_alarms import ALARM, robots
from tests.interop.test_node_opcua import run_client
from tests.system import Processes
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType

CLIENT = Path(__file__).parent / "alarms.cjs"


@pytest.mark.needs("node")
async def test_a_foreign_client_acknowledges_and_shelves(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port, robots=robots())) as running:
        async with running.client() as client:
            running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
            running.peer.publish(SPEED, 1.2)
            await until(reader(client, f"{ALARM}.Retain"), lambda found: found.Value.Value is True)
        code, output, errors = await run_client(running.url, *OPERATOR, tmp_path / "pki", ALARM, script=CLIENT)
    assert code == 0, errors
    report: dict[str, Any] = json.loads(output.splitlines()[-1])
    assert (report["refreshed"], report["acknowledged"], report["comment"]) == ("Good", "Good", "Good")
    assert report["again"] == "BadConditionBranchAlreadyAcked"
    assert report["active"]["EventType"] == "ns=0;i=9482"
    assert report["active"]["AckedState.Id"] is False
    assert report["commented"]["AckedState.Id"] is True
    assert {"ActiveState", "AckedState", "LimitState", "ShelvingState", "Acknowledge", "Suppress"} <= {
        *report["members"]
    }
    assert (report["shelved"], report["shelvedAgain"]) == ("Good", "BadConditionAlreadyShelved")
    assert report["shelvedEvent"]["ShelvingState.CurrentState"] == "TimedShelved"
    assert report["unshelved"] == "Good"


@pytest.mark.needs("node")
async def test_a_foreign_client_answers_a_decision(
    udp_url: str, tcp_port: int, tmp_path: Path, processes: Processes
) -> None:
    plant = Plant(tmp_path, udp_url, tcp_port, processes, "operator")
    plant.scenario("one", "  - {wait: 1}\n  - {task: first, skill: work, robot: left, arguments: {work: paint}}\n")
    for robot in ROBOTS:
        plant.bridge(robot)
    async with plant.server() as running, running.client() as client:
        await all_heard(client)
        run_id = await run(client, "one")
        await call(client, "Faults", "RaiseFault", "left", "gripper stuck")
        code, output, errors = await run_client(
            running.url, *OPERATOR, tmp_path / "pki", "dialog", "right", script=CLIENT
        )
        assert code == 0, errors
        report: dict[str, Any] = json.loads(output.splitlines()[-1])
        assert report["open"]["EventType"] == "ns=0;i=2830"
        assert report["open"]["ResponseOptionSet"] == ["middle", "right"]
        assert report["open"]["Prompt"].startswith("first: who takes over from left?")
        assert (report["wrong"], report["answered"]) == ("BadDialogResponseInvalid", "Good")
        assert (report["closed"]["LastResponse"], report["closed"]["Retain"]) == (1, False)
        assert report["late"] == "BadDialogNotActive"
        assert await run_is(client, run_id, "done", "failed") == "done"
        assert await value(client, f"Scenarios.Runs.{run_id}.Robots") == ["right"]
