"""A fleet's nodes in an address space that nobody listens to."""

# pyright: reportPrivateUsage=false

from __future__ import annotations

import importlib
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from typing import Any

from asyncua.server.server import Server

from tests.standard_space import quick_start
from tests.unit.fleet.fleet_of import ROBOTS, fleet_config
from ua_fleet.config.nodes import fleet_model
from ua_fleet.nodes.address_space import FleetNodes
from ua_fleet.nodes.nodeset import load_types

# asyncua declares UInt32 where it takes an int; tests use it without types.
ua: Any = importlib.import_module("asyncua.ua")


_made: list[Any] = []


async def _server() -> Any:
    """One server with the types for all tests of a run: making it takes longer than most of them."""
    if not _made:
        with quick_start():
            server: Any = Server()
            await server.init()
            await load_types(server, "urn:ua-fleet:fleet", 2)
        _made.append(server)
    return _made[0]


@asynccontextmanager
async def types_loaded() -> AsyncGenerator[Any]:
    """A server with the types, whose address space is afterwards what it was before."""
    server = await _server()
    space = server.iserver.aspace
    nodes = dict(space._nodes.items())  # those that were not wanted yet are made now
    objects = space[server.nodes.objects.nodeid].references
    before = list(objects)
    try:
        yield server
    finally:
        space._nodes = nodes
        objects[:] = before


@asynccontextmanager
async def fleet_built(robots: Mapping[str, Any] = ROBOTS) -> AsyncGenerator[tuple[Any, FleetNodes]]:
    """A server with the nodes of a fleet."""
    async with types_loaded() as server:
        nodes = FleetNodes(server.iserver.aspace, fleet_model(fleet_config(robots)))
        with quick_start():  # the collection before the nodes would take 0.7 s, since a process of tests holds much
            nodes.build()
        yield server, nodes


async def children(server: Any, node_id: str) -> dict[str, str]:
    """Browse names below a node with their NodeIds."""
    found = await server.get_node(node_id).get_children()
    return {(await node.read_browse_name()).to_string(): node.nodeid.to_string() for node in found}
