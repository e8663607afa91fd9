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

from tests.integration.scenarios.conftest import ROBOTS, Plant, call, says
from tests.integration.server_model.harness import ua
from tests.system import Child, Processes

SECURED: Final = {"security": "sign_and_encrypt", "keys": {"lifetime_s": 3.0, "future_keys": 30}}
SERVER: Final = "server"
TELLS_WITHIN_S: Final = 6.0
"""A bridge that works has told by then what became of executions: its SkillStatus is repeated every 5 s."""


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
        self._starting: set[str] = set()
        self.kills: list[tuple[float, str]] = []
        """When, by the wall clock, and whom."""

    async def begin(self, *names: str) -> None:
        """Start processes, and wait until they work."""
        self._starting.update(names)
        for name in names:
            start, _ = self._start[name]
            self._children[name] = start()
        for name in names:
            await says(self._children[name], self._start[name][1])
            self._starting.discard(name)

    async def kill(self, names: tuple[str, ...], count: int, most_s: float, *, after_all: bool = False) -> None:
        """Kill one of them so often, each time at a random moment of its work, and start it again at once.

        Args:
            names: of whom.
            count: how often.
            most_s: how long it works at most until it is killed.
            after_all: it is left alone until all others work: who is started meanwhile needs its keys.
        """
        random = Random(self._random.random())
        for _ in range(count):
            while after_all and self._starting:
                await asyncio.sleep(0.02)
            await asyncio.sleep(random.uniform(0.0, most_s))
            await self.kill_now(random.choice(names))

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


async def ended(client: Client, run_id: str, patience_s: float = 90) -> str:
    """Wait until a run has ended; how it did.

    While a bridge is away for long, its robot cannot be asked. What still nobody can tell when all work again was never
    begun, and people let it be tried again.
    """
    path = f"Fleet.Scenarios.Runs.{run_id}"
    nodes = [client.get_node(f"ns=2;s={path}.{name}") for name in ("State", "Steps", "States")]
    since: dict[str, float] = {}
    async with asyncio.timeout(patience_s):
        while True:
            state, steps, states = await client.read_values(nodes)
            if state in ("done", "failed", "aborted"):
                return str(state)
            asked = {step for step, shown in zip(steps, states, strict=True) if shown == "asked"}
            since = {step: since.get(step, time.monotonic()) for step in asked}
            for step, seen in since.items():
                if time.monotonic() - seen > TELLS_WITHIN_S:
                    await call(client, "Scenarios", "Answer", run_id, step, "retry")
            await asyncio.sleep(0.1)


async def agree(client: Client, run_id: str) -> None:
    """Let be tried again at once what nobody can tell."""
    path = f"Fleet.Scenarios.Runs.{run_id}"
    steps, states = await client.read_values([client.get_node(f"ns=2;s={path}.{name}") for name in ("Steps", "States")])
    for step, shown in zip(steps, states, strict=True):
        if shown == "asked":
            await call(client, "Scenarios", "Answer", run_id, step, "retry")


async def stop(client: Client) -> None:
    """Let the repetitions end."""
    number = ua.Variant(0, ua.VariantType.Int32)
    await client.get_node("ns=2;i=1300").write_value(ua.DataValue(number))


@pytest.fixture
def works(request: pytest.FixtureRequest, tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes) -> Plant:
    """A plant; the parameter changes its `pubsub`. Nobody is silent until it was away for long."""
    pubsub = {"receive_timeout_s": 30.0, **getattr(request, "param", {})}
    return Plant(tmp_path, udp_url, tcp_port, processes, "automatic", pubsub)
