"""Quick starts of servers in the process of the tests: the nodes that they all have are made once.

asyncua computes for a second to make the 6,000 nodes of the standard, 0.2 s to make those of a nodeset, and the garbage
collection that the server asks for before takes up to half a second more, since a process of tests holds much. Here
servers get copies of nodes that were made once, and nothing is collected while they start. No collection looks at what
was there then but each 250th start: to look at the modules of all tests takes 0.4 s, and more where they are shared
with the process that this one was forked off. The nodes of a server that has ended go with the next start. What is a
server's own is made as ever: its certificate and its nodes.
A process that is forked off one that has made them (`forking`) has them for its first server without a copy.
"""

from __future__ import annotations

import asyncio
import gc
import weakref
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, Final

from asyncua.server.address_space import AttributeValue, NodeData
from asyncua.server.internal_server import InternalServer
from asyncua.server.server import Server
from asyncua.ua.attribute_ids import AttributeIds

from ua_fleet.endpoint import hardened_server
from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.standard_nodes import share_attributes
from ua_fleet.nodes.nodeset import load_types

__all__ = ["make_for_one", "quick_start"]

_internal_server: Final[Any] = InternalServer
_server: Final[Any] = Server
_hardened: Final[Any] = hardened_server
_load: Final = _internal_server.load_standard_address_space
_OWN: Final = (
    AttributeIds.NodeId,
    AttributeIds.Value,
    AttributeIds.AccessLevel,
    AttributeIds.UserAccessLevel,
    AttributeIds.EventNotifier,
)
"""Attributes that a server replaces in place, or that no other node has: each node has an object for each."""
_for_one: list[dict[Any, Any]] = []
"""Nodes for the first server that starts."""
_starts: Final = count(1)
_COLLECTS_EACH: Final = 250
"""Starts after which is looked for what ended servers have left in cycles, 0.6 MB each; their nodes are gone before."""
_slow: Final[weakref.WeakSet[Any]] = weakref.WeakSet()
"""Those that have started as ever, and end so."""
_ended: list[weakref.ref[Any]] = []
"""Address spaces of servers that have ended since the last start."""
_starting: list[object] = []
_is_forked_off: list[bool] = []


class _Pattern:
    """Nodes to make copies of; what copies share with it is replaced and never changed: ids, values and references."""

    def __init__(self, nodes: dict[Any, Any]) -> None:
        places: dict[int, int] = {}
        self._values: list[Any] = []
        """What nodes have in common. A server has one object for each, as `share_attributes` would give it."""
        self._nodes: list[tuple[Any, tuple[Any, ...], tuple[int, ...], tuple[tuple[Any, Any], ...], list[Any]]] = []
        copies: dict[Any, Any] = {}
        for node_id, node in nodes.items():
            copies[node_id] = copy = NodeData(node.nodeid)
            copy.attributes = {number: AttributeValue(held.value) for number, held in node.attributes.items()}
            copy.references = list(node.references)
        space: Any = copies
        share_attributes(space)
        for node in copies.values():
            own = {number: held.value for number, held in node.attributes.items() if not self._is_common(number, held)}
            common = {number: held for number, held in node.attributes.items() if number not in own}
            for held in common.values():
                if id(held) not in places:
                    places[id(held)] = len(self._values)
                    self._values.append(held.value)
            numbers = tuple(places[id(held)] for held in common.values())
            self._nodes.append((node.nodeid, tuple(common), numbers, tuple(own.items()), node.references))

    @staticmethod
    def _is_common(number: Any, held: Any) -> bool:
        return number not in _OWN and isinstance(held, HeldValue)

    def copies(self) -> dict[Any, Any]:
        """Nodes for one more server, by their ids."""
        held: list[Any] = [HeldValue(value) for value in self._values]
        copies: dict[Any, Any] = {}
        for node_id, attributes, numbers, own, references in self._nodes:
            copies[node_id] = made = NodeData(node_id)
            made.attributes = {attribute: held[place] for attribute, place in zip(attributes, numbers, strict=True)}
            for number, value in own:
                made.attributes[number] = AttributeValue(value)
            made.references = list(references)
        return copies


@dataclass(frozen=True)
class _Nodeset:
    """What was imported from a nodeset."""

    nodes: _Pattern
    references: dict[Any, list[Any]]
    """Of nodes that were there before."""
    node_ids: list[Any]


_standard: list[_Pattern] = []
"""The nodes of the standard as asyncua makes them."""
_nodesets: dict[Any, _Nodeset] = {}
"""By their texts, and the indices that their namespaces have."""


async def _load_standard_address_space(server: Any, shelf_file: Path | None = None) -> None:
    if _for_one:
        server.aspace._nodes = _for_one.pop()
    elif not _starting:
        _slow.add(server)
        await _load(server, shelf_file)
    elif not _standard:
        await _load(server, shelf_file)
        _standard.append(_Pattern(server.aspace._nodes))
    else:
        server.aspace._nodes = _standard[0].copies()


_internal_server.load_standard_address_space = _load_standard_address_space
_stop: Final = _internal_server.stop
_release: Final = _hardened.release_collection


async def _stop_and_tell(server: Any) -> None:
    await _stop(server)
    _ended.append(weakref.ref(server.aspace))
    _hardened.release_collection = _release if server in _slow else _release_later


def _release_later() -> None:
    """It is one of `_COLLECTS_EACH`."""


_internal_server.stop = _stop_and_tell
_share: Final = _hardened.share_attributes


def _share_once(nodes: Any) -> None:
    """Copies share already what nodes have in common: to look through them again takes 10 ms."""
    if not (_starting or _is_forked_off):
        _share(nodes)


_hardened.share_attributes = _share_once
_import: Final = _server.import_xml


async def _import_xml(server: Any, path: str | None = None, xmlstring: str | None = None, **options: Any) -> Any:
    if xmlstring is None or options or not (_starting or _is_forked_off):
        return await _import(server, path, xmlstring, **options)
    names = await server.get_namespace_array()
    key = xmlstring, *((number, name) for number, name in enumerate(names) if name in xmlstring)
    nodes = server.iserver.aspace._nodes
    if (known := _nodesets.get(key)) is not None:
        nodes.update(known.nodes.copies())
        for node_id, references in known.references.items():
            nodes[node_id].references.extend(references)
        return list(known.node_ids)
    before = {node_id: len(node.references) for node_id, node in nodes.items()}
    node_ids = await _import(server, path, xmlstring)
    new = {node_id: node for node_id, node in nodes.items() if node_id not in before}
    added = {node_id: nodes[node_id].references[count:] for node_id, count in before.items()}
    _nodesets[key] = _Nodeset(_Pattern(new), {one: many for one, many in added.items() if many}, list(node_ids))
    return node_ids


_server.import_xml = _import_xml


def make_for_one() -> None:
    """Make the nodes of the first server that starts in this process, or in each that is forked off it."""

    async def make() -> None:
        server: Any = _server()
        await server.init()
        await load_types(server, "urn:any", 2)

    with quick_start():
        asyncio.run(make())
    _for_one.append(_standard.pop().copies())
    _is_forked_off.append(True)


@contextmanager
def quick_start() -> Generator[None]:
    """Servers that start meanwhile have copies of the standard's nodes, and the garbage collection rests."""
    start = object()
    was_on = gc.isenabled()
    while _ended:
        if (space := _ended.pop()()) is not None:
            space._nodes = {}
    if was_on and next(_starts) % _COLLECTS_EACH == 0:
        gc.unfreeze()
        gc.collect()
    gc.disable()
    _starting.append(start)
    try:
        yield
    finally:
        _starting.remove(start)
        if was_on:
            gc.freeze()
            gc.enable()
