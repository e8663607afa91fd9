"""Quick starts of servers in the process of the tests: the nodes that they all have are made once.

asyncua computes for a second to make the 6,000 nodes of the standard, 0.2 s to make those of a nodeset, and the garbage
collection that the server asks for before takes up to half a second more, since a process of tests holds much. Here
servers get copies of nodes that were made once, each when it is asked for, since most of them never are; and nothing is
collected while they start. What `create_server` and `load_types` do to each of the standard's nodes is done before they
are copied. No collection looks at what was there then but each 250th start: to look at the modules of all tests
takes 0.4 s, and more where they are shared with the process that this one was forked off. The nodes of a server that
has ended go with the next start. What is a server's own is made as ever: its certificate and its nodes.
A process that is forked off one that has made them (`forking`) has copies for its first server.
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
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

from asyncua.server.address_space import AttributeValue, NodeData
from asyncua.server.internal_server import InternalServer
from asyncua.server.server import Server
from asyncua.ua.attribute_ids import AttributeIds

from ua_fleet.endpoint import hardened_server, node_builder, standard_model
from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.standard_nodes import share_attributes
from ua_fleet.nodes import nodeset

__all__ = ["make_for_one", "quick_start"]

_internal_server: Final[Any] = InternalServer
_server: Final[Any] = Server
_hardened: Final[Any] = hardened_server
_nodeset: Final[Any] = nodeset
_load: Final = _internal_server.load_standard_address_space
_OWN: Final = (
    AttributeIds.NodeId,
    AttributeIds.Value,
    AttributeIds.AccessLevel,
    AttributeIds.UserAccessLevel,
    AttributeIds.EventNotifier,
)
"""Attributes that a server replaces in place, or that no other node has: each node has an object for each."""
_close: Final = standard_model.close_declarations
_close_standard_nodes: Final = _hardened._close_standard_nodes
_for_one: list[_Copies] = []
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


class _Recipe(NamedTuple):
    """Of one node; what copies share with it is replaced and never changed: ids, values and references."""

    pattern: _Pattern
    node_id: Any
    common: tuple[tuple[Any, int], ...]
    """Attributes that other nodes have too, and their places in what the pattern holds."""
    own: tuple[tuple[Any, Any], ...]
    references: list[Any]

    def make(self, held: list[Any]) -> Any:
        """A node for the server that has these."""
        made: Any = NodeData(self.node_id)
        attributes = made.attributes
        for attribute, place in self.common:
            if (shared := held[place]) is None:
                shared = held[place] = HeldValue(self.pattern.values[place])
            attributes[attribute] = shared
        for attribute, value in self.own:
            attributes[attribute] = AttributeValue(value)
        made.references = list(self.references)
        return made


class _Pattern:
    """Nodes to make copies of."""

    def __init__(self, nodes: dict[Any, Any]) -> None:
        places: dict[int, int] = {}
        self.values: list[Any] = []
        """What nodes have in common. A server has one object for each, as `share_attributes` would give it."""
        self.recipes: dict[Any, _Recipe] = {}
        copies: dict[Any, Any] = {}
        for node_id, node in nodes.items():
            copies[node_id] = copy = NodeData(node.nodeid)
            copy.attributes = {number: AttributeValue(held.value) for number, held in node.attributes.items()}
            copy.references = list(node.references)
        space: Any = copies
        share_attributes(space)
        for node_id, node in copies.items():
            own = {number: held.value for number, held in node.attributes.items() if not self._is_common(number, held)}
            common = {number: held for number, held in node.attributes.items() if number not in own}
            for held in common.values():
                if id(held) not in places:
                    places[id(held)] = len(self.values)
                    self.values.append(held.value)
            numbers = tuple((number, places[id(held)]) for number, held in common.items())
            self.recipes[node_id] = _Recipe(self, node.nodeid, numbers, tuple(own.items()), node.references)

    @staticmethod
    def _is_common(number: Any, held: Any) -> bool:
        return number not in _OWN and isinstance(held, HeldValue)


class _Copies(node_builder._Nodes):  # pyright: ignore[reportPrivateUsage]
    """The nodes of a server, each made when it is wanted: most never are."""

    def __init__(self) -> None:
        super().__init__()
        self._held: dict[_Pattern, list[Any]] = {}
        self.made: dict[Any, Any] = {}
        """Those that are made, and still there."""

    def add(self, pattern: _Pattern) -> None:
        """Have these nodes too."""
        self._held[pattern] = [None] * len(pattern.values)
        self.update(pattern.recipes)

    def __getitem__(self, node_id: Any) -> Any:
        node = super().__getitem__(node_id)
        if type(node) is _Recipe:
            node = self.made[node_id] = node.make(self._held[node.pattern])
            self.update({node_id: node})
        return node

    def __setitem__(self, node_id: Any, node: Any) -> None:
        super().__setitem__(node_id, node)
        self.made[node_id] = node

    def __delitem__(self, node_id: Any) -> None:
        super().__delitem__(node_id)
        self.made.pop(node_id, None)

    def __contains__(self, node_id: object) -> bool:
        return node_id in self.keys() or super().__contains__(node_id)

    def _all(self) -> None:
        for node_id, node in list(super().items()):
            if type(node) is _Recipe:
                self[node_id]

    def items(self) -> Any:
        """All, made now."""
        self._all()
        return super().items()

    def values(self) -> Any:
        """All, made now."""
        self._all()
        return super().values()


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


def _copies() -> _Copies:
    nodes = _Copies()
    nodes.add(_standard[0])
    return nodes


async def _load_standard_address_space(server: Any, shelf_file: Path | None = None) -> None:
    if _for_one:
        server.aspace._nodes = _for_one.pop()
    elif not _starting:
        _slow.add(server)
        await _load(server, shelf_file)
    else:
        if not _standard:
            await _load(server, shelf_file)
            _close(server.aspace)
            _close_standard_nodes(SimpleNamespace(iserver=server))
            _standard.append(_Pattern(server.aspace._nodes))
        server.aspace._nodes = _copies()


_internal_server.load_standard_address_space = _load_standard_address_space
_stop: Final = _internal_server.stop


def _made_nodes_of(space: Any) -> Any:
    """What is made of a recipe is as `share_attributes` and `_close_standard_nodes` leave it."""
    return space._nodes.made if isinstance(space._nodes, _Copies) else space._nodes


def _close_unless_copied(space: Any) -> None:
    if not isinstance(space._nodes, _Copies):
        _close(space)


_hardened.nodes_of = _made_nodes_of
_hardened.close_declarations = _nodeset.close_declarations = _close_unless_copied
_release: Final = _hardened.release_collection


async def _stop_and_tell(server: Any) -> None:
    await _stop(server)
    _ended.append(weakref.ref(server.aspace))
    _hardened.release_collection = _release if server in _slow else _release_later


def _release_later() -> None:
    """It is one of `_COLLECTS_EACH`."""


_internal_server.stop = _stop_and_tell
_import: Final = _server.import_xml


async def _import_xml(server: Any, path: str | None = None, xmlstring: str | None = None, **options: Any) -> Any:
    if xmlstring is None or options or not (_starting or _is_forked_off):
        return await _import(server, path, xmlstring, **options)
    names = await server.get_namespace_array()
    key = xmlstring, *((number, name) for number, name in enumerate(names) if name in xmlstring)
    nodes = server.iserver.aspace._nodes
    if (known := _nodesets.get(key)) is None:
        before = {node_id: len(node.references) for node_id, node in nodes.items()}
        node_ids = await _import(server, path, xmlstring)
        _close(server.iserver.aspace)
        new = {node_id: node for node_id, node in nodes.items() if node_id not in before}
        added = {node_id: nodes[node_id].references[count:] for node_id, count in before.items()}
        _nodesets[key] = _Nodeset(_Pattern(new), {one: many for one, many in added.items() if many}, list(node_ids))
        return node_ids
    nodes.add(known.nodes)
    for node_id, references in known.references.items():
        nodes[node_id].references.extend(references)
    return list(known.node_ids)


_server.import_xml = _import_xml


def make_for_one() -> None:
    """Make the nodes of the first server that starts in this process, or in each that is forked off it."""

    async def make() -> None:
        server: Any = _server()
        await server.init()
        await nodeset.load_types(server, "urn:any", 2)

    with quick_start():
        asyncio.run(make())
    _for_one.append(_copies())
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
