"""A foreign client reads the summaries of robots by the definition that the server gives of their structure."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import OBSERVER, ROBOTS, SPEED, fleet_config, reader, serving, until
from tests.interop.test_node_opcua import run_client
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType

SCRIPT = Path(__file__).parent / "summaries.cjs"


@pytest.mark.needs("node")
async def test_a_foreign_client_decodes_the_summaries_by_itself(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    robots = {**ROBOTS, "visitor": {"bridge": "mobile_side"}}
    async with serving(tmp_path, fleet_config(udp_url, tcp_port, robots=robots)) as running:
        running.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        running.peer.publish(SPEED, 0.25)
        async with running.client(OBSERVER) as client:
            await until(reader(client, "ns=2;s=Robots.rover.LastUpdate"), lambda data: data.StatusCode.is_good())
        code, output, errors = await run_client(running.url, *OBSERVER, tmp_path / "pki", script=SCRIPT)
        assert code == 0, errors
        (rover, visitor), empty = json.loads(output.splitlines()[-1])["groups"]

        assert empty == []
        assert {one["type"] for one in (rover, visitor)} == {"RobotSummaryDataType"}
        assert (rover["name"], rover["bridge"], rover["capacities"]) == ("rover", "mobile_side", ["mobile"])
        assert _age(rover["lastUpdate"]) < timedelta(minutes=1)
        assert _age(rover["stateSince"]) < timedelta(minutes=1)
        assert rover["quality"] in ("Good", "BadNoCommunication")  # nobody drives it meanwhile
        nothing = {"task": "", "runId": "", "held": False, "heldBy": "", "heldReason": ""}
        assert {name: visitor[name] for name in nothing} == nothing
        assert (visitor["name"], visitor["state"], visitor["capacities"]) == ("visitor", 0, [])
        assert visitor["quality"].startswith("Bad")
        assert visitor["lastUpdate"] in (None, "1601-01-01T00:00:00.000Z")


def _age(text: Any) -> timedelta:
    return abs(datetime.now(UTC) - datetime.fromisoformat(str(text)))
