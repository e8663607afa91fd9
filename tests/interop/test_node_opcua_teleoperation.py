"""A foreign OPC UA client, node-opcua, drives a robot by hand, with nothing but what the server shows it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import OBSERVER, OPERATOR
from tests.integration.teleoperation.served import fleet, floor, until_value
from tests.interop.test_node_opcua import run_client

CLIENT = Path(__file__).parent / "teleoperation.cjs"


@pytest.mark.needs("node")
async def test_a_foreign_client_drives_a_robot_and_an_observer_does_not(
    udp_url: str, tcp_port: int, tmp_path: Path
) -> None:
    async with floor(tmp_path, fleet(udp_url, tcp_port)) as made, made.running.client() as client:
        reports: list[dict[str, Any]] = []
        for user in (OPERATOR, OBSERVER):
            code, output, errors = await run_client(made.running.url, *user, tmp_path / "pki", script=CLIENT)
            assert code == 0, errors
            reports.append(json.loads(output.splitlines()[-1]))
        assert await until_value(client, "LastEnd", bool) == "oscar: released"
        await until_value(client, "State", 0)
    report, refused = reports
    assert {"Acquire", "Renew", "Release", "Drive", "Holder", "Counter", "Axes", "Drops"} <= set(report["members"])
    assert report["executable"] == dict.fromkeys(("Acquire", "Renew", "Release", "Drive"), True)
    assert report["input"] == ["Lease", "Number", "Echo", "Values"]
    assert report["axes"] == ["linear", "angular"]
    assert report["acquired"]["status"] == "Good"
    assert set(report["driven"]) == {"Good"}
    assert report["output"] == pytest.approx([0.4, -0.2])
    assert report["counters"] > 5
    assert report["taken"] > 10
    assert (report["renewed"], report["released"], report["after"]) == ("Good", "Good", "BadInvalidState")
    assert (0.4, -0.2) in [tuple(round(speed, 9) for speed in each) for each in made.carrier.written]
    assert made.carrier.written[-1] == (0.0, 0.0)
    assert refused["executable"] == dict.fromkeys(("Acquire", "Renew", "Release", "Drive"), False)
    assert refused["acquired"]["status"] == "BadUserAccessDenied"
