"""A server and bridges as processes that are killed at random moments, and started again at once."""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random
from typing import Final

import pytest
from asyncua.client.client import Client

from tests.integration.scenarios.conftest import ROBOTS, Plant, says
from tests.integration.server_model.harness import ua
from tests.system import Child, Processes

SECURED: Final = {"security": "sign_and_encrypt", "keys": {"lifetime_s": 3.0, "future_keys": 30}}
SERVER: Final = "server"


class Crew:
    """The processes of a plant by name; each is killed and started again by `kill`."""

    def __init__(self, start: dict[str, tuple[Callable[[], Child], str]], random: Random) -> None:
        """Make a crew of which nothing runs.

        Args:
            start: starts each process; with what it says when it works.
            random: says when to kill, and whom.
        """
        self._start, self._random = start, random
        self._children: dict[str, Child] = {}
        self.kills: list[tuple[float, str]] = []
        """When, by the wall clock, and whom."""

    async def begin(self, *names: str) -> None:
        """Start processes, and wait until they work."""
        for name in names:
            start, _ = self._start[name]
            self._children[name] = start()
        for name in names:
            await says(self._children[name], self._start[name][1])

    async def kill(self, names: tuple[str, ...], count: int, least_s: float, most_s: float) -> None:
        """Kill one of them so often, each time at a random moment of its work, and start it again at once."""
        for _ in range(count):
            name = self._random.choice(names)
            await asyncio.sleep(self._random.uniform(least_s, most_s))
            await self.kill_now(name)

    async def kill_now(self, name: str) -> None:
        """Kill a process, and start it again at once."""
        assert self._children[name].end(signal.SIGKILL) == -signal.SIGKILL, "it had ended by itself"
        self.kills.append((time.time(), name))
        await self.begin(name)

    def end(self) -> None:
        """End all."""
        for child in self._children.values():
            child.end()


def crew_of(plant: Plant, seed: int) -> Crew:
    """The server and all bridges."""
    start: dict[str, tuple[Callable[[], Child], str]] = {SERVER: (plant.start_server, "opc.tcp://")}
    for robot in ROBOTS:
        start[robot] = partial(plant.start_bridge, robot), "ready"
    return Crew(start, Random(seed))


async def stop(client: Client) -> None:
    """Let the repetitions end."""
    number = ua.Variant(0, ua.VariantType.Int32)
    await client.get_node("ns=2;i=1300").write_value(ua.DataValue(number))


@pytest.fixture
def works(request: pytest.FixtureRequest, tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes) -> Plant:
    """A plant; the parameter changes its `pubsub`. Nobody is silent until it was away for long."""
    pubsub = {"receive_timeout_s": 30.0, **getattr(request, "param", {})}
    return Plant(tmp_path, udp_url, tcp_port, processes, "automatic", pubsub)
