"""What a viewer may not do, a foreign OPC UA client is refused too: the server decides, whatever a page shows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.console.conftest import FLEET
from tests.integration.server_model.harness import ENGINEER, OBSERVER, OPERATOR, fleet_config, serving
from tests.interop.test_node_opcua import run_client

CLIENT = Path(__file__).parent / "viewer.cjs"
OPERATORS = {
    "Fleet.Scenarios": ("Run", "Pause", "Resume", "Abort", "Answer", "TellEvent", "Validate", "DryRun"),
    "Fleet.Resilience": ("Confirm", "JudgeDecision"),
    "Fleet.Faults": ("RaiseFault", "ClearFault"),
}
ENGINEERS = {
    "Fleet": ("RegisterRobot", "UnregisterRobot", "RecentMessages"),
    "Fleet.Scenarios": ("Store", "Delete"),
    "Fleet.Resilience": ("SetMode", "SetJudgements"),
}
ALL = {"Fleet.Scenarios": ("Text",), "Fleet.Resilience": ("Preview", "WhatIf")}
BATTERY = "ns=2;i=1005"


def pairs(methods: dict[str, tuple[str, ...]]) -> list[tuple[str, str]]:
    return [(f"ns=2;s={owner}", f"ns=2;s={owner}.{name}") for owner, names in methods.items() for name in names]


OF_ROBOT = [("ns=2;s=Robots.rover", "ns=3;i=72051"), ("ns=2;i=1600", "ns=2;s=1600.Start")]
"""Hold, and a skill."""


@pytest.mark.needs("node")
async def test_roles_are_the_servers_for_a_foreign_client_too(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    operators, engineers, everybody = [*pairs(OPERATORS), *OF_ROBOT], pairs(ENGINEERS), pairs(ALL)
    reports: dict[str, dict[str, Any]] = {}
    async with serving(tmp_path, fleet_config(udp_url, tcp_port, robots=FLEET)) as running:
        for user in (OBSERVER, OPERATOR, ENGINEER):
            asked = json.dumps([*operators, *engineers, *everybody])
            code, output, errors = await run_client(running.url, *user, tmp_path / "pki", asked, BATTERY, script=CLIENT)
            assert code == 0, errors
            reports[user[0]] = json.loads(output.splitlines()[-1])

    def refused(user: tuple[str, str]) -> set[str]:
        told = reports[user[0]]["methods"]
        denied = {method for method, (_, status) in told.items() if status == "BadUserAccessDenied"}
        hidden = {method for method, (may, _) in told.items() if not may}
        assert hidden == denied, "what cannot be called is shown so"
        return denied

    assert refused(OBSERVER) == {method for _, method in [*operators, *engineers]}
    assert refused(OPERATOR) == {method for _, method in engineers}
    assert refused(ENGINEER) == set()
    assert (reports[OBSERVER[0]]["written"], reports[OBSERVER[0]]["read"]) == ("BadUserAccessDenied", ["Good", 80])
    assert (reports[OPERATOR[0]]["written"], reports[OPERATOR[0]]["read"]) == ("Good", ["Good", 12])
