# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Which Variables of robots a list of them shows: those that the server marks, else how full the battery is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from asyncua import ua

from ua_fleet.client.charges import charge_nodes
from ua_fleet.client.details import value_details
from ua_fleet.client.translated import translated

if TYPE_CHECKING:
    from ua_fleet.client.fleet_client import FleetClient

__all__ = ["CardNode", "card_nodes"]

_MOST: Final = 3
"""Of a robot; a server of another make may mark more."""


@dataclass(frozen=True, slots=True)
class CardNode:
    """A Variable of a robot."""

    robot: str
    name: str
    """As people say it: `battery`, `pose.x`."""
    node_id: str
    unit: str
    names: Mapping[int, str]
    """Of an enumeration's values."""


async def card_nodes(client: FleetClient, most: int) -> list[CardNode]:
    """Those of all robots, in the order of each card.

    Args:
        client: connected.
        most: of a fleet with more robots none are told.

    Raises:
        NotConnected: the connection was lost.
    """
    robots = await client.robots()
    if len(robots) > most:
        return []
    with translated(client.endpoint):
        cards = [ua.NodeId.from_string(f"{node.to_string()}.Card") for node in robots.values()]
        told = await client.batches.read(cards)
        marked = [
            (robot, node)
            for robot, data in zip(robots, told, strict=True)
            for node in (_value(data) or ())[:_MOST]
            if isinstance(node, ua.NodeId)
        ]
        names = await _names(client, [node for _, node in marked])
        details = await value_details(client.batches, [node for _, node in marked])
    found = [
        CardNode(robot, name, node.to_string(), detail.unit, detail.names)
        for (robot, node), name, detail in zip(marked, names, details, strict=True)
    ]
    with_card = {robot for robot, _ in marked}
    charges = await charge_nodes(client, most) if len(with_card) < len(robots) else []
    found += [CardNode(one.robot, one.name, one.node_id, one.unit, {}) for one in charges if one.robot not in with_card]
    return found


async def _names(client: FleetClient, nodes: list[ua.NodeId]) -> list[str]:
    """Browse names, before those of fields that of their data source: it has the number before the point."""
    above = [_above(node) for node in nodes]
    told = await client.batches.read([*nodes, *[node for node in above if node]], ua.AttributeIds.BrowseName)
    names = [str(getattr(_value(data), "Name", "") or "") for data in told]
    sources = iter(names[len(nodes) :])
    return [
        f"{source}.{name}" if node is not None and (source := next(sources)) else name
        for name, node in zip(names, above, strict=False)
    ]


def _above(node: ua.NodeId) -> ua.NodeId | None:
    number, dot, _ = str(node.Identifier).partition(".")
    return ua.NodeId.from_string(f"ns={node.NamespaceIndex};i={number}") if dot and number.isdecimal() else None


def _value(data: ua.DataValue) -> Any:
    return None if data.Value is None else data.Value.Value
