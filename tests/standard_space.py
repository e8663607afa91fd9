"""Quick starts of servers in the process of the tests: the nodes that they all have are made once.

asyncua computes for a second to make the 6,000 nodes of the standard, 0.2 s to make those of a nodeset, and the garbage
collection that the server asks for before takes up to half a second more, since a process of tests holds much. Here
servers get copies of nodes that were made once, and nothing is collected while they start; and those that make a key
have the same. What is a server's own is made as ever: its certificate and its nodes.
A process that is forked off one that has made them (`forking`) has them for its first server without a copy.
"""

from __future__ import annotations

import asyncio
import functools
import gc
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

from asyncua.server.address_space import AttributeValue, NodeData
from asyncua.server.internal_server import InternalServer
from asyncua.server.server import Server
from asyncua.ua import ReferenceDescription
from cryptography.hazmat.primitives.asymmetric import rsa

from ua_fleet.nodes.nodeset import load_types

__all__ = ["make_for_one", "quick_start"]

_internal_server: Final[Any] = InternalServer
_server: Final[Any] = Server
_rsa: Final[Any] = rsa
_load: Final = _internal_server.load_standard_address_space
_parts: Final = attrgetter(*[field.name for field in fields(ReferenceDescription)])
_made: dict[Any, Any] = {}
"""The nodes of the standard as asyncua makes them; no server has these."""
_for_one: list[dict[Any, Any]] = []
"""Nodes for the first server that starts."""
_starting: list[object] = []
_is_forked_off: list[bool] = []


@dataclass(frozen=True)
class _Nodeset:
    """What was imported from a nodeset."""

    nodes: dict[Any, Any]
    references: dict[Any, list[Any]]
    """Of nodes that were there before."""
    node_ids: list[Any]


_nodesets: dict[Any, _Nodeset] = {}
"""By their texts, and the indices that their namespaces have."""


def _of_its_own(references: list[Any]) -> list[Any]:
    return [ReferenceDescription(*_parts(reference)) for reference in references]


def _copied(nodes: dict[Any, Any]) -> dict[Any, Any]:
    """Nodes that share with these only what is replaced and never changed: ids, and what attributes hold."""
    copies: dict[Any, Any] = {}
    for node_id, node in nodes.items():
        copies[node_id] = made = NodeData(node.nodeid)
        made.attributes = {number: AttributeValue(held.value) for number, held in node.attributes.items()}
        made.references = _of_its_own(node.references)
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
_import: Final = _server.import_xml


async def _import_xml(server: Any, path: str | None = None, xmlstring: str | None = None, **options: Any) -> Any:
    if xmlstring is None or options or not (_starting or _is_forked_off):
        return await _import(server, path, xmlstring, **options)
    names = await server.get_namespace_array()
    key = xmlstring, *((number, name) for number, name in enumerate(names) if name in xmlstring)
    nodes = server.iserver.aspace._nodes
    if (known := _nodesets.get(key)) is not None:
        nodes.update(_copied(known.nodes))
        for node_id, references in known.references.items():
            nodes[node_id].references.extend(_of_its_own(references))
        return list(known.node_ids)
    before = {node_id: len(node.references) for node_id, node in nodes.items()}
    node_ids = await _import(server, path, xmlstring)
    new = {node_id: node for node_id, node in nodes.items() if node_id not in before}
    added = {node_id: _of_its_own(nodes[node_id].references[count:]) for node_id, count in before.items()}
    _nodesets[key] = _Nodeset(_copied(new), {one: many for one, many in added.items() if many}, list(node_ids))
    return node_ids


_server.import_xml = _import_xml
_generate: Final = functools.cache(_rsa.generate_private_key)


def _generate_private_key(*args: Any, **options: Any) -> Any:
    return (_generate if _starting else _generate.__wrapped__)(*args, **options)


_rsa.generate_private_key = _generate_private_key


def make_for_one() -> None:
    """Make the nodes of the first server that starts in this process, or in each that is forked off it."""

    async def make() -> None:
        server: Any = _server()
        await server.init()
        await load_types(server, "urn:any", 2)

    with quick_start():
        asyncio.run(make())
    _for_one.append(dict(_made))
    _made.clear()
    _is_forked_off.append(True)


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
