"""A foreign OPC UA client, node-opcua, registers a robot, calls it, unregisters it, and does a skill itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.robots.conftest import MACHINE, Yard
from tests.integration.server_model.harness import ENGINEER
from tests.interop.test_node_opcua import run_client
from tests.system import Processes

CLIENT = Path(__file__).parent / "robots.cjs"
SKILL = "arguments: {what: {type: String}}\nresults: {fixed: {type: Boolean}}\n"


@pytest.mark.needs("node")
async def test_a_foreign_client_registers_calls_and_unregisters_a_robot(
    udp_url: str, tcp_port: int, tmp_path: Path, processes: Processes
) -> None:
    yard = Yard(tmp_path, udp_url, tcp_port, processes)
    yard.bridge()
    async with yard.server() as running:
        code, output, errors = await run_client(
            running.url, *ENGINEER, tmp_path / "pki", json.dumps(MACHINE), SKILL, script=CLIENT
        )
    assert code == 0, errors
    report: dict[str, Any] = json.loads(output.splitlines()[-1])
    assert report["wrong"] == {"status": 2, "lines": [0, 2, 2]}
    assert report["registered"] == {"status": 0, "message": "", "node": "ns=2;s=Robots.machine"}
    assert (report["started"], report["done"]) == ("Good", "polish")
    assert (report["unregistered"], report["gone"]) == (0, "BadNodeIdUnknown")
    assert report["offered"] == {"status": 0, "message": ""}
    assert report["asking"] == "Good"
    assert (report["asked"][0]["names"], report["asked"][0]["values"]) == (["what"], ["the belt"])
    assert (report["accepted"], report["completed"], report["fixed"]) == (0, 0, True)
    robots = ["ns=2;s=Robots.machine", "ns=2;s=Robots.machine", "ns=2;s=Robots.mechanic"]
    assert report["changes"] == [[robot, verb] for robot, verb in zip(robots, (1, 2, 1), strict=True)]
    assert [job.work for job in yard.machine.told()] == ["polish"]
