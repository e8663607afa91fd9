"""Quick starts of servers in the process of the tests: the nodes that the standard gives each of them are made once.

asyncua computes for a second to make these 6,000 nodes, and the garbage collection that the server asks for before
takes up to half a second more, since a process of tests holds much. Here servers get copies of nodes that were made
once, and nothing is collected while they start. What is a server's own is made as ever: certificate, types, nodes.
A process that is forked off one that has made them (`forking`) has them for its first server without a copy.
"""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import fields
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

from asyncua.server.address_space import AttributeValue, NodeData
from asyncua.server.internal_server import InternalServer
from asyncua.ua import ReferenceDescription

__all__ = ["make_for_one", "quick_start"]

_internal_server: Final[Any] = InternalServer
_load: Final = _internal_server.load_standard_address_space
_parts: Final = attrgetter(*[field.name for field in fields(ReferenceDescription)])
_made: dict[Any, Any] = {}
"""The nodes of the standard as asyncua makes them; no server has these."""
_for_one: list[dict[Any, Any]] = []
"""Nodes for the first server that starts."""
_starting: list[object] = []


def _copied(nodes: dict[Any, Any]) -> dict[Any, Any]:
    """Nodes that share with these only what is replaced and never changed: ids, and what attributes hold."""
    copies: dict[Any, Any] = {}
    for node_id, node in nodes.items():
        copies[node_id] = made = NodeData(node.nodeid)
        made.attributes = {number: AttributeValue(held.value) for number, held in node.attributes.items()}
        made.references = [ReferenceDescription(*_parts(reference)) for reference in node.references]
    return copies


async def _load_standard_address_space(server: Any, shelf_file: Path | None = None) -> None:
    if _for_one:
        server.aspace._nodes = _for_one.pop()
    elif not _starting:
        await _load(server, shelf_file)
    elif not _made:
        await _load(server, shelf_file)
        _made.update(_copied(server.aspace._nodes))
    else:
        server.aspace._nodes = _copied(_made)


_internal_server.load_standard_address_space = _load_standard_address_space


def make_for_one() -> None:
    """Make the nodes of the first server that starts in this process, or in each that is forked off it."""

    async def made() -> dict[Any, Any]:
        server: Any = _internal_server()
        await _load(server)
        nodes: dict[Any, Any] = server.aspace._nodes
        return nodes

    _for_one.append(asyncio.run(made()))


@contextmanager
def quick_start() -> Generator[None]:
    """Servers that start meanwhile have copies of the standard's nodes, and the garbage collection rests."""
    start = object()
    was_on = gc.isenabled()
    gc.disable()
    _starting.append(start)
    try:
        yield
    finally:
        _starting.remove(start)
        if was_on:
            gc.enable()
