"""A robot in ROS 2 that the server has never heard of: its bridge announces it, and a client commands it."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from tests.integration.ros2.conftest import Ros2Space
from tests.integration.ros2.skilled import SKILLS
from tests.integration.server_model.harness import ENGINEER, serving
from ua_fleet.client import ClientIdentity, FleetClient, NodeNotFound, RobotClient
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import RobotOffline

pytestmark = [
    pytest.mark.needs("ros2"),
    # rclpy's type support imports lark, which imports a deprecated module of the standard library.
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),
]

ROBOTS = {"carrier": {"bridge": "mobile", "skill_status_id": 1000, "capacities": ["carry"], "skills": SKILLS}}


async def test_it_is_commanded_as_its_bridge_announces_it(ros2: Ros2Space, tmp_path: Path, tcp_port: int) -> None:
    config = FleetConfig.model_validate(
        {
            "version": 1,
            "server": {"port": tcp_port, "trust_all_clients": True, "unknown_sources": "create"},
            "pubsub": {"security": "none", "url": ros2.udp_url},
        }
    )
    await asyncio.to_thread(ros2.bridge, ROBOTS)
    robot = await asyncio.to_thread(ros2.node, "skilled.py", ros2.domain)
    async with (
        serving(tmp_path, config) as running,
        FleetClient.connect(
            running.url, user=ENGINEER[0], password=ENGINEER[1], identity=ClientIdentity(tmp_path / "identity")
        ) as client,
        asyncio.timeout(60),
    ):
        while True:
            try:
                results = await client.call_skill("carrier", "drive", to="dock", seconds=0.1)
            except (NodeNotFound, RobotOffline):
                await asyncio.sleep(0.1)
            else:
                break
        assert results == {"distance": 2.5}
        (carrier,) = await RobotClient(client).robots()
        assert (carrier.name, carrier.state, carrier.origin) == ("carrier", "idle", "announced")
        assert set(carrier.skills) == set(SKILLS)
    assert any("drive dock" in line for line in robot.lines)
