# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Which Variable of a robot says how full its battery is, by its name, read in few requests for all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from asyncua import ua

from ua_fleet.client.details import value_details
from ua_fleet.client.status import CHARGES
from ua_fleet.client.translated import translated

if TYPE_CHECKING:
    from ua_fleet.client.fleet_client import FleetClient

__all__ = ["ChargeNode", "charge_nodes"]

_HAS_PROPERTY: Final = ua.NodeId(ua.Int32(ua.ObjectIds.HasProperty))


@dataclass(frozen=True, slots=True)
class ChargeNode:
    """The Variable of one robot."""

    robot: str
    name: str
    node_id: str
    unit: str


async def charge_nodes(client: FleetClient, most: int) -> list[ChargeNode]:
    """Those of all robots that have one; none of a fleet of more than `most` robots. Raises NotConnected."""
    robots = await client.robots()
    if len(robots) > most:
        return []
    best: dict[str, tuple[int, str, ua.NodeId]] = {}
    with translated(client.endpoint):
        level = [(name, ua.NodeId.from_string(f"{node.to_string()}.Data")) for name, node in robots.items()]
        while level:
            deeper: list[tuple[str, ua.NodeId]] = []
            answers = await client.batches.browse([node for _, node in level])
            for (robot, _), children in zip(level, answers, strict=True):
                for child in children:
                    name = str(child.BrowseName.Name)
                    if child.ReferenceTypeId == _HAS_PROPERTY:
                        continue
                    if child.NodeClass is not ua.NodeClass.Variable:
                        deeper.append((robot, child.NodeId))
                    elif name in CHARGES:
                        place = CHARGES.index(name), name, child.NodeId
                        best[robot] = min(best.get(robot, place), place, key=lambda one: one[0])
            level = deeper
        found = sorted(best.items())
        details = await value_details(client.batches, [node for _, (_, _, node) in found])
    return [
        ChargeNode(robot, name, node.to_string(), detail.unit)
        for (robot, (_, name, node)), detail in zip(found, details, strict=True)
    ]
