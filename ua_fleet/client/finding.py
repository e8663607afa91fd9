# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Nodes by the names that people give them: addresses, objects with what is below them, and patterns."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from asyncua import Client, Node, ua
from asyncua.ua.ua_binary import nodeid_to_binary
from asyncua.ua.uaerrors import UaError

from ua_fleet.client.addresses import parse_address
from ua_fleet.client.batches import Batches
from ua_fleet.client.patterns import Pattern, has_wildcard
from ua_fleet.client.translated import NodeNotFound

__all__ = ["Finder", "SelectedNode"]

_LEFT_OUT: Final = re.compile(r"G[0-9]{2,}|Data")
"""Folders of the server's model that hold nothing but order: groups of at most 100, and a robot's data."""
_FLEET: Final = ua.NodeId(ua.String("Fleet"), ua.Int16(2))
_ROBOTS: Final = ua.NodeId(ua.String("Fleet.Robots"), ua.Int16(2))
_BRIDGES: Final = ua.NodeId(ua.String("Fleet.Bridges"), ua.Int16(2))
_ROOTS: Final = ("Objects", "Fleet")
_HAS_PROPERTY: Final = ua.NodeId(ua.Int32(ua.ObjectIds.HasProperty))
_CLASSES: Final = int(ua.NodeClass.Object) | int(ua.NodeClass.Variable)


@dataclass(frozen=True, slots=True)
class SelectedNode:
    """A Variable that was asked for."""

    node_id: str
    name: str
    """As it was asked for, or its place below what was asked for, e.g. `rover/battery`."""
    is_named: bool = True
    """Whether it was asked for itself, by an address or a pattern; else an Object above it was."""


@dataclass(frozen=True, slots=True)
class _Place:
    """A node on the way down."""

    node: ua.NodeId
    name: str
    order: tuple[int, ...]
    """Its place among the children, and theirs: what nodes are sorted by."""
    states: frozenset[int]
    is_below: bool
    """Whether it, or an Object above it, is one that is asked for."""
    is_match: bool = False
    """Whether it is one that is asked for."""


@dataclass(frozen=True, slots=True)
class _Found:
    node: ua.NodeId
    name: str
    order: tuple[int, ...]
    node_class: ua.NodeClass
    is_named: bool


class Finder:
    """Finds nodes over a connection. Methods raise NodeNotFound, and asyncua's errors."""

    def __init__(self, client: Client, batches: Batches) -> None:
        self._client, self._batches = client, batches

    async def node(self, address: str) -> Node:
        """The one node of an address: NodeId, UA topic, path below Objects, or name below the robots or bridges."""
        parsed = parse_address(address)
        if isinstance(parsed, str):
            return self._by_id(parsed)
        node = self._client.nodes.objects
        for depth, name in enumerate(parsed):
            below = await self._child(node, name)
            if below is None and depth == 0:
                return await self._short(address, name)
            if below is None:
                above = "/".join(parsed[:depth])
                raise NodeNotFound(f"there is no {name!r} below {above}; look with: ua-fleet browse {above}")
            node = below
        return node

    async def select(self, addresses: Sequence[str]) -> list[SelectedNode]:
        """The Variables that addresses and patterns stand for, in their order.

        An Object stands for all Variables below it that were not found before; Properties are left out but where they
        are named.
        """
        found: list[SelectedNode] = []
        known: set[str] = set()
        for address in addresses:
            selected = await self._selected(address)
            found += [one for one in selected if one.node_id not in known or one.name == address]
            known.update(one.node_id for one in selected)
        return found

    async def _selected(self, address: str) -> list[SelectedNode]:
        if not isinstance(parse_address(address), str) and has_wildcard(address):
            selected = _variables(await self._matching(Pattern(address)))
            if not selected:
                raise NodeNotFound(f"no value has a name like {address!r}; look with: ua-fleet browse Fleet/Robots")
            return selected
        node = (await self.node(address)).nodeid
        (node_class,) = await self._batches.read([node], ua.AttributeIds.NodeClass)
        kind = None if node_class.Value is None else node_class.Value.Value
        if kind is None:
            raise NodeNotFound(f"there is no node {address}; look with: ua-fleet browse")
        if kind != ua.NodeClass.Object:
            return [SelectedNode(node.to_string(), address)]
        start = _Place(node, address.rstrip("/"), (), frozenset(), is_below=True)
        below = _variables(await self._walk([start], None))
        if not below:
            raise NodeNotFound(f"{address} has no value; look below it with: ua-fleet browse {address}")
        return below

    async def robots(self) -> dict[str, ua.NodeId]:
        """The nodes of all robots, by their names."""
        (groups,) = await self._batches.browse([_ROBOTS], classes=int(ua.NodeClass.Object))
        answers = await self._batches.browse([group.NodeId for group in groups], classes=int(ua.NodeClass.Object))
        return {str(child.BrowseName.Name): child.NodeId for children in answers for child in children}

    def _by_id(self, text: str) -> Node:
        try:
            node = self._client.get_node(text)
            nodeid_to_binary(node.nodeid)  # its numbers may be none of the wire's
        except (UaError, ValueError, struct.error):
            raise NodeNotFound(f"{text!r} is not a NodeId; look with: ua-fleet browse") from None
        return node

    async def _child(self, node: Node, name: str) -> Node | None:
        """The node of that name below a node; groups and `Data` folders may be left out of a path."""
        level = [node.nodeid]
        while level:
            children = [child for below in await self._batches.browse(level) for child in below]
            for child in children:
                browse_name = child.BrowseName
                if name in (
                    browse_name.Name,
                    f"{browse_name.NamespaceIndex}:{browse_name.Name}",
                    child.DisplayName.Text,
                ):
                    return self._client.get_node(child.NodeId)
            level = [child.NodeId for child in children if _LEFT_OUT.fullmatch(child.BrowseName.Name or "")]
        return None

    async def _short(self, address: str, first: str) -> Node:
        """The one node below the robots, or below the bridges, that a text without wildcards names."""
        matching = [] if has_wildcard(address) else await self._matching(Pattern(address), whole=False)
        if not matching:
            raise NodeNotFound(
                f"there is no {first!r} below Objects, and no robot or bridge of that name; look with: ua-fleet browse"
            )
        if len(matching) > 1:
            names = ", ".join(one.node.to_string() for one in matching[:3])
            raise NodeNotFound(f"{address!r} names {len(matching)} nodes: {names}; give a NodeId, or / between names")
        return self._client.get_node(matching[0].node)

    async def _matching(self, pattern: Pattern, *, whole: bool = True) -> list[_Found]:
        """What a pattern names; with `whole` also what is below the Objects that it names."""
        (below,) = await self._batches.browse([_FLEET], classes=_CLASSES)
        names = [child.BrowseName.Name for child in below]
        states, is_rooted = pattern.start, pattern.first in names
        for root in _ROOTS:
            fed = pattern.feed(states, root)
            if pattern.first in _ROOTS and fed:
                states, is_rooted = fed, True
        if is_rooted:
            is_all = pattern.is_match(states)
            return await self._walk([_Place(_FLEET, "Fleet", (), states, is_all)], pattern, whole=whole)
        for node in (_ROBOTS, _BRIDGES):
            found = await self._walk([_Place(node, "", (), states, is_below=False)], pattern, whole=whole)
            if found:
                return found
        return []

    async def _walk(self, level: list[_Place], pattern: Pattern | None, *, whole: bool = True) -> list[_Found]:
        """What is found below some nodes, a level at a time, in the order of the tree."""
        found: list[_Found] = []
        seen = {place.node for place in level}
        while level:
            answers = await self._batches.browse([place.node for place in level], classes=_CLASSES)
            deeper: list[_Place] = []
            for above, children in zip(level, answers, strict=True):
                for place, child in _below(above, children, pattern):
                    is_property = child.ReferenceTypeId == _HAS_PROPERTY
                    is_named = place.is_match and (not is_property or (pattern is not None and pattern.ends_literally))
                    if is_named or (whole and above.is_below and not is_property):
                        found.append(_Found(child.NodeId, place.name, place.order, child.NodeClass, is_named))
                    # What is below a value is looked at where it is named, and not for each of 100,000 values.
                    is_leaf = child.NodeClass is ua.NodeClass.Variable and (pattern is None or pattern.has_depth)
                    may_go_on = not is_leaf and (bool(place.states) or (whole and place.is_below))
                    if may_go_on and not is_property and place.node not in seen:
                        seen.add(place.node)
                        deeper.append(place)
            level = deeper
        return sorted(found, key=lambda one: one.order)


def _below(
    above: _Place, children: Sequence[ua.ReferenceDescription], pattern: Pattern | None
) -> Iterator[tuple[_Place, ua.ReferenceDescription]]:
    for number, child in enumerate(children):
        name = child.BrowseName.Name or ""
        states = pattern.feed(above.states, name) if pattern is not None else above.states
        is_match = pattern is not None and pattern.is_match(states)
        if _LEFT_OUT.fullmatch(name):
            states, path = states | above.states, above.name
        else:
            path = f"{above.name}/{name}" if above.name else name
        yield _Place(child.NodeId, path, (*above.order, number), states, above.is_below or is_match, is_match), child


def _variables(found: Sequence[_Found]) -> list[SelectedNode]:
    variables = [one for one in found if one.node_class is ua.NodeClass.Variable]
    return [SelectedNode(one.node.to_string(), one.name, one.is_named) for one in variables]
