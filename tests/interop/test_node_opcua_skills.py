"""A foreign OPC UA client, node-opcua, has a robot do something, with nothing but what the server shows it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import OPERATOR
from tests.integration.skills.conftest import Hall
from tests.interop.test_node_opcua import run_client
from tests.system import Processes

CLIENT = Path(__file__).parent / "skills.cjs"


@pytest.mark.needs("node")
async def test_a_foreign_client_calls_a_skill_and_sees_its_events(
    udp_url: str, tcp_port: int, tmp_path: Path, processes: Processes
) -> None:
    hall = Hall(tmp_path, udp_url, tcp_port, processes)
    hall.bridge()
    async with hall.server() as running:
        code, output, errors = await run_client(running.url, *OPERATOR, tmp_path / "pki", script=CLIENT)
    assert code == 0, errors
    report: dict[str, Any] = json.loads(output.splitlines()[-1])
    assert set(report["skills"]) >= {"2:work", "2:quick"}
    assert {"Start", "Suspend", "Resume", "Halt", "Reset", "CurrentState", "3:Progress", "3:LastResult"} <= set(
        report["members"]
    )
    assert report["input"] == [
        {"name": "work", "dataType": "ns=0;i=12", "description": "What to do; usually weld"},
        {"name": "seconds", "dataType": "ns=0;i=11", "description": "How long it takes; 0 to 10 s"},
    ]
    assert report["output"] == ["ExecutionId"]
    assert report["outOfRange"]["status"] == "BadInvalidArgument"
    assert report["outOfRange"]["arguments"] == ["Good", "BadOutOfRange"]
    assert report["wrongType"]["arguments"] == ["Good", "BadTypeMismatch"]
    assert report["missing"]["status"] == "BadArgumentsMissing"
    assert report["started"]["status"] == "Good"
    (execution,) = report["started"]["output"]
    began, ended, *others = report["events"]
    assert (began["from"], began["to"], began["isOver"]) == ("Ready", "Running", False)
    assert (ended["from"], ended["to"], ended["isOver"]) == ("Running", "Ready", True)
    assert ended["transition"] == "RunningToReady"
    assert (ended["source"], ended["name"], ended["robot"]) == ("ns=2;i=1900", "machine.work", "machine")
    assert began["execution"] == ended["execution"] == execution
    assert (ended["status"], ended["names"], ended["results"]) == ("Good", ["done", "seconds"], ["polish", 0.3])
    assert (report["done"], report["state"]) == ("polish", "Ready")
    assert report["asked"] == ["Good"] * 4
    assert [event["transition"] for event in others] == [
        *("ReadyToRunning", "RunningToSuspended", "SuspendedToRunning", "RunningToSuspended", "SuspendedToHalted")
    ]
    assert [job.work for job in hall.machine.told()] == ["polish", "never ends"]
