"""A foreign client reads history: raw in pages, at times, and aggregates."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import OBSERVER, fleet_config, serving
from tests.integration.server_model.test_history import LONG, SPEED_NODE, moment, stored
from tests.interop.test_node_opcua import run_client

SCRIPT = Path(__file__).parent / "history.cjs"


@pytest.mark.needs("node")
async def test_a_foreign_client_reads_history(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    stored(tmp_path, 0, 10, 20, 30)
    async with serving(tmp_path, fleet_config(udp_url, tcp_port, history={"days": LONG})) as running:
        times = [moment(second).isoformat() for second in (0, 40)]
        code, output, errors = await run_client(
            running.url, *OBSERVER, tmp_path / "pki", SPEED_NODE, *times, script=SCRIPT
        )
    assert code == 0, errors
    report = json.loads(output.splitlines()[-1])
    raw = report["raw"]
    # Three values in a page: the fourth, and the bound of the end, come with the second one.
    assert (raw["status"], raw["pages"]) == ("Good", 2)
    assert _values(raw)[:4] == [0, 10, 20, 30]
    assert raw["values"][1]["time"] == moment(10).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    assert len(raw["values"]) == 5
    assert _values(report["atTimes"]) == [15, 0]
    assert [one["status"] & 0x41F for one in report["atTimes"]["values"]] == [0x402, 0]
    assert {name: _values(found) for name, found in report["processed"].items()} == {
        "Average": [5, 25],
        "TimeAverage": [10, 27.5],
        "Minimum": [0, 20],
        "Maximum": [10, 30],
        "Count": [2, 2],
        "PercentGood": [100, 100],
    }
    assert report["node"] == {"accessLevel": 5, "historizing": True}
    assert report["own"] == [0, 10, 20, 30, None]  # it asks for bounds


def _values(found: Any) -> list[Any]:
    return [one["value"] for one in found["values"]]
