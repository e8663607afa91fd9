"""The address space of 1,000 robots x 30 nodes, beside asyncua's own add_object and add_variable.

Both make the same tree: groups of 100 robots, a robot's object and 30 Double variables below it. Ours also has what
every robot has (State, LastUpdate, Description, Capacities, three folders), and starts from the checked `fleet.yaml`.
Asyncua's run has its default garbage collection.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import gc
import time
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

from asyncua.server.server import Server

from benchmarks.harness import FEWEST_ROUNDS, Figure, at_most, interleaved
from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import FleetConfig
from ua_fleet.nodes.address_space import FleetNodes
from ua_fleet.nodes.nodeset import load_types

ROBOTS = 1_000
NODES = 30
GOAL = 0.6


def fleet_config() -> FleetConfig:
    robots = {
        f"R{robot:04d}": {
            "bridge": "side",
            "capacities": ["mobile"],
            "data": {f"value{index}": {"id": 1 + robot * NODES + index, "type": "Double"} for index in range(NODES)},
        }
        for robot in range(ROBOTS)
    }
    return FleetConfig.model_validate(
        {
            "version": 1,
            "pubsub": {"security": "none"},
            "bridges": {"side": {"kind": "ros2", "space": 2}},
            "robots": robots,
        }
    )


async def build_ours(server: Any, config: FleetConfig) -> None:
    FleetNodes(server.iserver.aspace, fleet_model(config)).build()


async def build_stock(server: Any, _config: FleetConfig) -> None:
    group = server.nodes.objects
    for robot in range(ROBOTS):
        if robot % 100 == 0:
            group = await server.nodes.objects.add_folder(2, f"G{robot // 100:02d}")
        node = await group.add_object(2, f"R{robot:04d}")
        for index in range(NODES):
            await node.add_variable(2, f"value{index}", 0.0)


async def measured(build: Callable[[Any, FleetConfig], Awaitable[None]], config: FleetConfig) -> float:
    server: Any = Server()
    await server.init()
    await load_types(server, "urn:ua-fleet:fleet", 2)
    before = len(server.iserver.aspace.keys())
    gc.collect()
    started = time.perf_counter()
    await build(server, config)
    seconds = time.perf_counter() - started
    made = len(server.iserver.aspace.keys()) - before
    assert made >= ROBOTS * (NODES + 1), made
    await server.stop()
    return seconds


def in_a_fresh_server(build: Callable[[Any, FleetConfig], Awaitable[None]], config: FleetConfig) -> float:
    """Seconds that a build takes; afterwards the memory is as before."""
    seconds = asyncio.run(measured(build, config))
    gc.unfreeze()
    gc.collect()
    return seconds


def figures(rounds: int = FEWEST_ROUNDS) -> list[Figure]:
    config = fleet_config()
    stock, ours = interleaved(
        rounds, [partial(in_a_fresh_server, build_stock, config), partial(in_a_fresh_server, build_ours, config)]
    )
    name = f"{ROBOTS:,} robots x {NODES} nodes"
    reference = "asyncua add_object, add_variable"
    return [at_most(name, ours, "s", reference=reference, reference_value=stock, goal=GOAL)]
