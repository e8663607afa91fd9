"""A robot in ROS 1 that the server has never heard of: its bridge announces it, and a client commands it."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from tests.integration.ros1.ros1_graph import Ros1Graph
from tests.integration.ros1.skilled import ROBOTS
from tests.integration.server_model.harness import ENGINEER, serving
from ua_fleet.client import ClientIdentity, FleetClient, NodeNotFound, RobotClient
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import RobotOffline

pytestmark = pytest.mark.needs("ros1")


async def test_it_is_commanded_as_its_bridge_announces_it(graph: Ros1Graph, tmp_path: Path, tcp_port: int) -> None:
    config = FleetConfig.model_validate(
        {
            "version": 1,
            "server": {"port": tcp_port, "trust_all_clients": True, "unknown_sources": "create"},
            "pubsub": {"security": "none", "url": graph.pubsub_url},
        }
    )
    await asyncio.to_thread(graph.master)
    await asyncio.to_thread(graph.bridge, ROBOTS)
    robot = await asyncio.to_thread(graph.node, "skilled.py")
    async with (
        serving(tmp_path, config) as running,
        FleetClient.connect(
            running.url, user=ENGINEER[0], password=ENGINEER[1], identity=ClientIdentity(tmp_path / "identity")
        ) as client,
        asyncio.timeout(90),  # a busy machine takes its time; nothing here is about how long
    ):
        while True:
            try:
                results = await client.call_skill("arm", "drive", to="dock", seconds=0.1)
            except (NodeNotFound, RobotOffline):
                await asyncio.sleep(0.1)
            else:
                break
        assert results == {"distance": 2.5}
        while True:  # the end of the skill is told before the state that follows from it
            (arm,) = await RobotClient(client).robots()
            if arm.state == "idle" and set(arm.skills) == set(ROBOTS["arm"]["skills"]):
                break
            await asyncio.sleep(0.1)
        assert (arm.name, arm.origin) == ("arm", "announced")
    await asyncio.to_thread(robot.wait_for, "drive dock")
