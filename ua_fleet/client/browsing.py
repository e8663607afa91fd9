# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""The nodes below a node, a level at a time: few requests, however many nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from asyncua import ua

from ua_fleet.client.batches import Batches
from ua_fleet.client.details import type_names

__all__ = ["FoundVariable", "NodeInfo", "browse_below", "variables_below"]

_HAS_PROPERTY: Final = ua.NodeId(ua.Int32(ua.ObjectIds.HasProperty))
_COUNTED: Final = 2_000
"""Nodes of the last level, at most, of which is looked how much is below them."""


@dataclass(frozen=True, slots=True)
class NodeInfo:
    """A node as it is browsed."""

    node_id: str
    browse_name: str
    display_name: str
    node_class: str
    depth: int
    type_name: str | None = None
    """Of a Variable: its DataType, e.g. `Double` or `String[]`."""
    is_property: bool = False
    left_out: int | None = 0
    """Nodes directly below it that are not listed, since `depth` ends above them; None where nobody has counted."""


@dataclass(slots=True)
class _Place:
    order: tuple[int, ...]
    node: ua.NodeId
    info: NodeInfo


class FoundVariable(NamedTuple):
    """A Variable below one of several nodes."""

    root: str
    """Name of that node."""
    path: tuple[str, ...]
    """Browse names from there down."""
    node: ua.NodeId


async def variables_below(batches: Batches, roots: Mapping[str, ua.NodeId]) -> list[FoundVariable]:
    """The Variables below nodes and below the Objects there, without properties and what is below Variables.

    An Object that is reached twice is entered once. Raises asyncua's errors.
    """
    found: list[FoundVariable] = []
    seen = set(roots.values())
    level = [FoundVariable(root, (), node) for root, node in roots.items()]
    while level:
        deeper: list[FoundVariable] = []
        answers = await batches.browse([one.node for one in level])
        for above, children in zip(level, answers, strict=True):
            for child in children:
                if child.ReferenceTypeId == _HAS_PROPERTY:
                    continue
                one = FoundVariable(above.root, (*above.path, str(child.BrowseName.Name)), child.NodeId)
                if child.NodeClass is ua.NodeClass.Variable:
                    found.append(one)
                elif child.NodeClass is ua.NodeClass.Object and child.NodeId not in seen:
                    seen.add(child.NodeId)
                    deeper.append(one)
        level = deeper
    return found


async def browse_below(batches: Batches, node: ua.NodeId, *, depth: int) -> list[NodeInfo]:
    """The nodes below a node, depth first, down to `depth` levels; a node that is reached twice is entered once."""
    found: list[_Place] = []
    seen = {node}
    above: list[tuple[tuple[int, ...], ua.NodeId]] = [((), node)]
    last: list[_Place] = []
    for level in range(depth):
        answers = await batches.browse([one for _, one in above])
        places = [
            _Place((*order, number), child.NodeId, _info(child, level))
            for (order, _), children in zip(above, answers, strict=True)
            for number, child in enumerate(children)
        ]
        found += places
        last = [place for place in places if place.node not in seen]
        above = []
        for place in last:
            if place.node not in seen:
                seen.add(place.node)
                above.append((place.order, place.node))
    await _count(batches, [place for place in last if not place.info.is_property])
    await _tell_types(batches, [place for place in found if place.info.node_class == "Variable"])
    return [place.info for place in sorted(found, key=lambda place: place.order)]


async def _count(batches: Batches, last: Sequence[_Place]) -> None:
    if len(last) > _COUNTED:
        for place in last:
            place.info = replace(place.info, left_out=None)
        return
    for place, children in zip(last, await batches.browse([place.node for place in last]), strict=True):
        # Properties belong to their node, and are no level that somebody would miss.
        below = sum(child.ReferenceTypeId != _HAS_PROPERTY for child in children)
        place.info = replace(place.info, left_out=below)


async def _tell_types(batches: Batches, variables: Sequence[_Place]) -> None:
    names = await type_names(batches, [place.node for place in variables])
    for place, name in zip(variables, names, strict=True):
        place.info = replace(place.info, type_name=name)


def _info(child: ua.ReferenceDescription, level: int) -> NodeInfo:
    name = child.BrowseName.Name or ""
    return NodeInfo(
        child.NodeId.to_string(),
        name,
        child.DisplayName.Text or name,
        child.NodeClass.name,
        level,
        is_property=child.ReferenceTypeId == _HAS_PROPERTY,
    )
