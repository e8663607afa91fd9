"""Bridges that are processes of their own, with keys from a server, while their keys change and the server is away."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from tests.integration.key_service.harness import INVALIDATE, ROTATE
from tests.integration.security.conftest import COUNTER_ONE, COUNTER_TWO, Site, heard, holes, secured
from tests.integration.server_security.harness import CHEAP
from tests.standard_space import quick_start
from tests.system import Child
from tests.waiting import until
from ua_fleet.client.fleet_client import FleetClient
from ua_fleet.client.identity import ClientIdentity
from ua_fleet.config.security import all_groups
from ua_fleet.endpoint.users import USERS_FILE, Role, UserStore
from ua_fleet.server.app import run_server
from ua_fleet.server.mutual_trust import introduce_bridge
from ua_fleet.topics import Topic

__all__ = ["secured"]

ENGINEER = ("eva", "engineer-1")


class Plant:
    """A site whose keys come from its server."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self.url = f"opc.tcp://127.0.0.1:{site.port}/ua_fleet"
        state_dir = site.folder / site.config.server.state_dir
        UserStore(state_dir / USERS_FILE, CHEAP).add(*ENGINEER, Role.ENGINEER)

    async def introduce(self) -> None:
        for name in self.site.config.bridges:
            await introduce_bridge(self.site.config, self.site.folder, name)

    @asynccontextmanager
    async def server(self) -> AsyncGenerator[None]:
        ready: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        with quick_start():
            task = asyncio.ensure_future(run_server(self.site.config, self.site.folder, ready=ready.set_result))
            waited: list[asyncio.Future[Any]] = [task, ready]
            await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED, timeout=30)
        try:
            assert ready.done(), "it did not start"
            yield
            assert not task.done(), task.exception()
        finally:
            task.cancel()
            await asyncio.wait([task])

    @asynccontextmanager
    async def engineer(self) -> AsyncGenerator[FleetClient]:
        identity = ClientIdentity(self.site.folder / "engineer")
        user, password = ENGINEER
        async with FleetClient.connect(self.url, user=user, password=password, identity=identity) as client:
            yield client

    async def bridge(self, name: str) -> Child:
        """Start a bridge; it is ready once it has the key that it publishes with."""
        child = self.site.bridge(name, wait=False)
        await until(lambda: "ready" in child.lines)
        return child


@pytest.fixture
def plant(secured: Site) -> Plant:
    secured.write_fleet(keys={"source": "service", "lifetime_s": 2.0, "future_keys": 8})
    return Plant(secured)


async def more(child: Child, topic: Topic, count: int = 30) -> None:
    """Wait until a bridge has heard more of a topic."""
    before = len(heard(child, topic))
    await until(lambda: len(heard(child, topic)) >= before + count)


async def test_keys_change_by_themselves_and_by_an_engineer(plant: Plant) -> None:
    await plant.introduce()
    async with plant.server():
        one, two = await plant.bridge("one"), await plant.bridge("two")
        await more(two, COUNTER_ONE)
        await more(one, COUNTER_TWO)
        # Three lifetimes, and keys that become current before their time: nothing is lost.
        async with plant.engineer() as engineer:
            for _ in range(3):
                await more(two, COUNTER_ONE, 150)
                for group in all_groups(plant.site.config):
                    await engineer.call(f"ns=2;s=SecurityGroups.{group}", ROTATE)
            await more(two, COUNTER_ONE, 250)
            assert holes(heard(two, COUNTER_ONE)) == holes(heard(one, COUNTER_TWO)) == []
            # Keys that are thrown away cost a moment, and no more.
            async with asyncio.timeout(5):
                for group in all_groups(plant.site.config):
                    await engineer.call(f"ns=2;s=SecurityGroups.{group}", INVALIDATE)
                await asyncio.sleep(1)
                await more(two, COUNTER_ONE)
                await more(one, COUNTER_TWO)


async def test_bridges_go_on_while_the_server_is_away(plant: Plant) -> None:
    await plant.introduce()
    async with plant.server():
        one, two = await plant.bridge("one"), await plant.bridge("two")
        await more(two, COUNTER_ONE)
        await more(one, COUNTER_TWO)
    # Two lifetimes and more.
    await more(two, COUNTER_ONE, 500)
    async with plant.server():
        await more(two, COUNTER_ONE, 300)
        await more(one, COUNTER_TWO)
    assert holes(heard(two, COUNTER_ONE)) == []


async def test_a_bridge_waits_until_it_is_known(plant: Plant) -> None:
    async with plant.server():
        child = plant.site.bridge("one", wait=False)
        identity = ClientIdentity.of_bridge(plant.site.folder / "state" / "bridges" / "one", "Fleet", "one")
        await until(identity.certificate.exists)
        await asyncio.sleep(1)
        assert "ready" not in child.lines
        await introduce_bridge(plant.site.config, plant.site.folder, "one")
        await until(lambda: "ready" in child.lines)
