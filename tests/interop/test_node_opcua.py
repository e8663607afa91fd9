"""A foreign OPC UA client, node-opcua, at our server: encrypted, with user and password."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.server_model.harness import GOAL, OPERATOR, SPEED, fleet_config, serving
from tests.interop.node import run_node
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType

CLIENT = Path(__file__).parent / "client.cjs"


async def run_client(
    url: str, user: str, password: str, folder: Path, *more: str, script: Path = CLIENT, timeout_s: float = 60
) -> tuple[int, str, str]:
    """Run the foreign client to its end."""
    return await run_node(script, url, user, password, folder, *more, timeout_s=timeout_s)


@pytest.mark.needs("node")
async def test_foreign_client_browses_reads_subscribes_and_writes(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running:
        peer = running.peer
        peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        peer.publish(SPEED, 0.25)

        async def drive() -> None:
            speed = 0.25
            while True:
                await asyncio.sleep(0.15)
                speed = -speed
                peer.publish(SPEED, speed)

        driving = asyncio.ensure_future(drive())
        try:
            code, output, errors = await run_client(running.url, *OPERATOR, tmp_path / "pki")
        finally:
            driving.cancel()
            await asyncio.wait([driving])
        assert code == 0, errors
        report: dict[str, Any] = json.loads(output.splitlines()[-1])

        assert report["namespaces"][2:4] == ["urn:ua-fleet:fleet", "http://ua-fleet.org/UA/"]
        assert {"3:Robots", "3:Bridges", "3:Capabilities", "3:Discovered", "3:Traffic"} <= set(report["fleet"])
        assert {"3:State", "3:LastUpdate", "3:Capacities", "3:Data", "3:Skills"} <= set(report["robot"])
        assert set(report["data"]) >= {"2:speed", "2:goal", "2:velocity", "2:pose"}
        speed = report["speed"]
        assert (abs(speed["value"]), speed["dataType"], speed["status"]) == (0.25, "Double", "Good")
        assert speed["sourceTimestamp"] is not None
        assert speed["serverTimestamp"] is not None
        assert report["unit"] == "m/s"
        assert report["range"] == [-2, 2]
        assert report["writes"] == {
            "legal": "Good",
            "outOfRange": "BadOutOfRange",
            "notANumber": "BadOutOfRange",
            "wrongType": "BadTypeMismatch",
            "robotsOwn": "BadNotWritable",
        }
        assert report["written"]["value"] == 0.5
        assert len(report["notified"]) >= 3
        assert {abs(told["value"]) for told in report["notified"]} == {0.25}
        await peer.until(lambda: (0.5,) in peer.good(GOAL))


@pytest.mark.needs("node")
async def test_foreign_client_with_a_wrong_password_is_refused(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running:
        code, _, errors = await run_client(running.url, OPERATOR[0], "wrong-password", tmp_path / "pki")
        assert code == 1
        assert "BadUserAccessDenied" in errors or "BadIdentityTokenRejected" in errors
