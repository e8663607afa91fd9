"""A foreign OPC UA client, node-opcua, runs a scenario through Methods alone, and chooses a replacement."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.scenarios.conftest import ROBOTS, Plant, all_heard
from tests.integration.server_model.harness import OPERATOR
from tests.interop.test_node_opcua import run_client
from tests.system import Processes
from ua_fleet.nodes.nodeset import TypeId

CLIENT = Path(__file__).parent / "scenarios.cjs"


@pytest.mark.needs("node")
async def test_a_foreign_client_runs_ranks_and_confirms(
    udp_url: str, tcp_port: int, tmp_path: Path, processes: Processes
) -> None:
    plant = Plant(tmp_path, udp_url, tcp_port, processes, "operator")
    plant.scenario(
        "two",
        "  - {task: first, skill: work, robot: left}\n"
        "  - {wait: 1}\n"
        "  - {task: second, skill: work, robot: left, arguments: {work: paint}}\n",
    )
    for robot in ROBOTS:
        plant.bridge(robot)
    async with plant.server() as running:
        async with running.client() as client:
            await all_heard(client)
        code, output, errors = await run_client(running.url, *OPERATOR, tmp_path / "pki", script=CLIENT)
    assert code == 0, errors
    report: dict[str, Any] = json.loads(output.splitlines()[-1])
    assert report["listed"] == ["two"]
    valid, texts, lines = report["problems"]
    assert (valid, lines) == (False, [4])
    assert "left has no skill 'jump'" in texts[0]
    assert report["confirmed"] == ["taken"]
    assert "has chosen right before" in report["refused"]
    assert report["preview"] == ["middle", "right"]
    assert report["stored"] == [True, 32]
    assert (report["held"][1], report["heldBy"], report["heldAgain"]) == ("", OPERATOR[0], "")
    assert report["robots"] == ["left", "right"]
    kinds = {event["type"] for event in report["events"]}
    assert kinds >= {
        f"ns=3;i={kind.value}"
        for kind in (TypeId.RUN_EVENT, TypeId.STEP_EVENT, TypeId.DECISION_EVENT, TypeId.FAULT_ALARM)
    }
    alarm = next(event for event in report["events"] if event["message"].startswith("left: gripper stuck;"))
    assert (alarm["active"], alarm["source"]) == (True, "ns=2;s=Robots.left")
    ranked = next(event for event in report["events"] if event["decisionState"] == "open")
    assert ranked["robots"] == ["middle", "right"]
    assert sum(ranked["scores"]) == pytest.approx(1)
    assert plant.told() == [("left", "weld"), ("right", "paint")]
