"""`fleet_status` of a fleet that is too large for reading all of its nodes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from tests.integration.peer import Peer
from tests.integration.server_model.harness import OPERATOR, SPACE, fleet_config, serving, until
from tests.integration.server_model.test_summaries import robots
from ua_fleet.client import (
    ClientIdentity,
    FleetClient,
    FleetStatus,
    NodeNotFound,
    RobotClient,
    fleet_status,
    status,
    summaries,
)
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType


@asynccontextmanager
async def telling(peer: Peer) -> AsyncGenerator[None]:
    """All robots tell their values all the time."""
    topics = [Topic(SPACE, 2, 1 + number) for number in range(8)]
    for topic in topics:
        peer.announce(topic, (make_field("data", BuiltinType.DOUBLE),))

    async def tell() -> None:
        while True:
            for topic in topics:
                peer.publish(topic, 0.5)
            await asyncio.sleep(0.1)

    task = asyncio.ensure_future(tell())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait([task])


async def test_the_summaries_say_how_robots_stand(
    udp_url: str, tcp_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(status, "MOST_LOOKED_AT", 5)
    monkeypatch.setattr(status, "MOST_NOT_WELL", 2)
    config = fleet_config(udp_url, tcp_port, robots=robots(8))
    async with serving(tmp_path, config) as running:
        identity = ClientIdentity(tmp_path / "identity")
        async with FleetClient.connect(
            running.url, user=OPERATOR[0], password=OPERATOR[1], identity=identity
        ) as client:

            async def look() -> FleetStatus:
                return await fleet_status(client)

            first = await look()
            assert [robot.name for robot in first.robots] == [f"r{number}" for number in range(8)]
            assert {robot.state for robot in first.robots} == {"offline"}
            # None of its values has come, and of the others nobody has looked at the values.
            assert [robot.values for robot in first.robots[:3]] == [{}, {}, None]
            assert [robot.quality for robot in first.robots[:3]] == ["", "", "BadWaitingForInitialData"]

            async with telling(running.peer):
                well = await until(look, lambda found: all(robot.quality == "Good" for robot in found.robots[:5]))
                assert {robot.state for robot in well.robots[:5]} == {"idle"}
            await RobotClient(client).hold("r7", "")
            held = await until(look, lambda found: found.robots[7].held_by)
            assert held.robots[7].since is not None
            everything = await fleet_status(client, all_values=True)
            assert all(robot.values is not None and not robot.quality for robot in everything.robots)
            assert everything.robots[7].held_by == OPERATOR[0]


async def test_a_server_without_summaries_is_read_robot_by_robot(
    udp_url: str, tcp_port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(status, "MOST_LOOKED_AT", 1)
    monkeypatch.setattr(summaries, "_FOLDER", "ns=2;s=Fleet.NotThere")
    async with serving(tmp_path, fleet_config(udp_url, tcp_port, robots=robots(3))) as running:
        identity = ClientIdentity(tmp_path / "identity")
        async with FleetClient.connect(
            running.url, user=OPERATOR[0], password=OPERATOR[1], identity=identity
        ) as client:
            with pytest.raises(NodeNotFound, match="no summaries of robots"):
                await client.summaries()
            found = await fleet_status(client)
            assert [(robot.name, robot.values) for robot in found.robots] == [("r0", {}), ("r1", {}), ("r2", {})]
