"""`FleetClient.summaries` and `watch_summaries` at a whole server."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from asyncua import ua

from tests.integration.server_model.harness import ENGINEER, OBSERVER, Running, fleet_config, serving, until
from tests.integration.server_model.test_summaries import driving, robots
from tests.unit.nodes.model_server import types_loaded
from ua_fleet.client import ClientIdentity, FleetClient, RobotClient, RobotSummary, SummariesChanged
from ua_fleet.errors import NotConnected

ENCODING: Any = ua.NodeId(ua.Int32(5002), ua.Int16(3))


@pytest.fixture(autouse=True, params=["of this process", "of another process"])
async def known_to_asyncua(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """asyncua knows the structure where a server of this process has made it; a client of its own has the bytes."""
    async with types_loaded():
        assert ENCODING in ua.extension_objects_by_typeid
    is_known: bool = request.param == "of this process"
    if not is_known:
        monkeypatch.delitem(ua.extension_objects_by_typeid, ENCODING)
    return is_known


@asynccontextmanager
async def connected(running: Running, user: tuple[str, str] = OBSERVER) -> AsyncGenerator[FleetClient]:
    identity = ClientIdentity(running.folder / "identity")
    async with FleetClient.connect(running.url, user=user[0], password=user[1], identity=identity) as client:
        yield client


class Seen:
    """What a watch has told so far, as a page keeps it."""

    def __init__(self) -> None:
        self.robots: dict[str, RobotSummary] = {}
        self.is_whole = False
        self.times = 0

    def take(self, new: SummariesChanged) -> None:
        for robot in new.changed:
            assert self.robots.get(robot.name) != robot
            self.robots[robot.name] = robot
        for name in new.gone:
            del self.robots[name]
        self.is_whole |= new.is_whole
        self.times += 1

    async def follow(self, client: FleetClient) -> None:
        async with aclosing(client.watch_summaries(period_ms=50)) as changes:
            async for new in changes:
                self.take(new)


async def seen_until(seen: Seen, expected: Callable[[dict[str, RobotSummary]], bool]) -> None:
    async def look() -> Any:
        return seen.robots

    await until(look, expected)


async def test_all_robots_are_read_in_their_order(
    udp_url: str, tcp_port: int, tmp_path: Path, known_to_asyncua: bool
) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots(130))
    async with serving(tmp_path, config) as running, connected(running) as client:
        found = await client.summaries()
        assert [robot.name for robot in found] == [f"r{number}" for number in range(130)]
        (raw, *_), first = (await client.read("ns=2;s=Fleet.Summaries.1")).raw, found[0]
        assert isinstance(raw, dict) is not known_to_asyncua  # else asyncua has made an object of it
        assert (first.state, first.status_text, first.is_good) == ("offline", "BadWaitingForInitialData", False)
        assert (first.last_update, first.age_s(), first.bridge) == (None, None, "mobile_side")
        assert first.told is not None
        assert first.told.tzinfo is not None


async def test_who_meets_a_structure_first_keeps_it_from_nobody(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    """E.g. two tabs that watch it: one asks for its layout, and the other must not get the bytes meanwhile."""
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, connected(running) as client:
        readings = await asyncio.gather(*[client.read("ns=2;s=Fleet.Summaries.1") for _ in range(4)])
        assert not [one for reading in readings for one in reading.raw if isinstance(one, ua.ExtensionObject)]


async def test_a_watch_follows_the_robots(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    async with (
        serving(tmp_path, fleet_config(udp_url, tcp_port)) as running,
        connected(running) as client,
        connected(running, ENGINEER) as engineer,
    ):
        seen = Seen()
        following = asyncio.ensure_future(seen.follow(client))
        try:
            await seen_until(seen, lambda robots: "rover" in robots)
            async with driving(running.peer):
                await seen_until(seen, lambda robots: robots["rover"].is_good and robots["rover"].state == "idle")
                await seen_until(seen, lambda robots: robots["rover"].age_s() is not None)
                age_s = seen.robots["rover"].age_s()
                assert age_s is not None
                assert age_s < 5
                await RobotClient(engineer).hold("rover", "a new tyre")
                await seen_until(seen, lambda robots: robots["rover"].held)
                assert (seen.robots["rover"].held_by, seen.robots["rover"].held_reason) == (ENGINEER[0], "a new tyre")
            running.peer.mute()
            await seen_until(seen, lambda robots: robots["rover"].status_text == "BadNoCommunication")
            assert seen.robots["rover"].last_update is not None
            assert seen.is_whole
            assert client.dropped == 0
        finally:
            following.cancel()
            await asyncio.wait([following])


async def test_a_watch_sees_robots_for_which_there_was_no_variable(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    config = fleet_config(udp_url, tcp_port, robots=robots(99))
    async with (
        serving(tmp_path, config) as running,
        connected(running) as client,
        connected(running, ENGINEER) as engineer,
    ):
        seen = Seen()
        following = asyncio.ensure_future(seen.follow(client))
        try:
            await seen_until(seen, lambda robots: len(robots) == 99)
            guests = RobotClient(engineer)
            for name in ("guest1", "guest2", "guest3"):
                await guests.register(name, {"description": "of clients"})
            await seen_until(seen, lambda robots: len(robots) == 102)
            for name in ("guest1", "guest3"):
                await guests.unregister(name)
            await seen_until(seen, lambda robots: len(robots) == 100)
            assert "guest2" in seen.robots
        finally:
            following.cancel()
            await asyncio.wait([following])


async def test_a_watch_ends_with_the_connection(udp_url: str, tcp_port: int, tmp_path: Path) -> None:
    seen = Seen()
    async with serving(tmp_path, fleet_config(udp_url, tcp_port)) as running, connected(running) as client:
        following = asyncio.ensure_future(seen.follow(client))
        await seen_until(seen, lambda robots: "rover" in robots)
        client._client.disconnect_socket()  # pyright: ignore[reportPrivateUsage] - as when a cable is cut
        with pytest.raises(NotConnected):
            await asyncio.wait_for(following, 20)
