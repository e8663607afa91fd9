"""A foreign OPC UA client, node-opcua, has the nine tasks done through Methods alone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.e2e.talkrobots import demonstration
from tests.interop.test_node_opcua import run_client
from tests.system import Processes
from ua_fleet.fleet.model import RobotState
from ua_fleet.nodes.nodeset import TypeId

CLIENT = Path(__file__).parent / "talkrobots.cjs"
OPTIONS = ("--wait", "--speed", "15", "--resilience", "operator", "--without-ros1", "--secure")


@pytest.mark.needs("node", "ros2", "ur")
async def test_a_foreign_client_runs_the_nine_tasks_and_chooses_who_takes_over(
    processes: Processes, tmp_path: Path
) -> None:
    with demonstration(processes, tmp_path, *OPTIONS) as started:
        started.printed("ready: run nine_tasks")
        url, password = started.printed("UaExpert: "), started.printed("operator, password ")
        code, output, errors = await run_client(
            url, "operator", password, tmp_path / "pki", script=CLIENT, timeout_s=150
        )
        assert code == 0, errors
        report = started.finish(60)
    seen: dict[str, Any] = json.loads(output.splitlines()[-1])
    assert seen["validated"] == {"valid": True, "problems": []}
    assert seen["whatIf"]["tasks"] == ["fetch", "approach", "bring", "load"]
    assert seen["whatIf"]["best"] == ["", "pioneer_1", "pioneer_1", ""], "nobody else fetches or loads"
    kinds = {event["type"] for event in seen["events"]}
    assert kinds >= {
        f"ns=3;i={kind.value}"
        for kind in (TypeId.RUN_EVENT, TypeId.STEP_EVENT, TypeId.DECISION_EVENT, TypeId.FAULT_ALARM)
    }
    assert seen["alarm"]["message"] == "ridgeback lacks mobile: the drive does not turn"
    assert seen["taken"] == ["mobile"]
    assert seen["robotState"] != RobotState.FAULTED, "its arm works on"
    ranking = seen["ranking"]
    assert ranking["Robots"] == ["pioneer_1", "pioneer_2"]
    assert ranking["Criteria"] == ["battery", "distance", "availability"]
    assert len(ranking["RawValues"]) == len(ranking["CriterionScores"]) == 6
    assert "ridgeback" in ranking["Excluded"]
    assert seen["confirmed"] == ["taken"]
    begun = [event["task"] for event in seen["events"] if event["fact"] == "TaskAssigned"]
    assert len(begun) == 10, "nine tasks, one of them twice"
    assert seen["states"] == ["done"] * 9
    # Its own choice, and only for what needs the mobility that Ridgeback has lost.
    fault = report["fault"]
    assert (fault["robot"], fault["replacement"]) == ("ridgeback", "pioneer_2")
    robots = {row["task"]: row["robot"] for row in report["tasks"]}
    assert [robots[task] for task in ("approach", "bring", "load")] == ["pioneer_2", "pioneer_2", "ridgeback"]
    assert sorted(seen["robots"]) == sorted(robots.values())
