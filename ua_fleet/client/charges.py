# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false
"""Which Variable of a robot says how full its battery is, by its name, read in few requests for all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from asyncua import ua

from ua_fleet.client.browsing import variables_below
from ua_fleet.client.details import value_details
from ua_fleet.client.status import CHARGES
from ua_fleet.client.translated import translated

if TYPE_CHECKING:
    from ua_fleet.client.fleet_client import FleetClient

__all__ = ["ChargeNode", "charge_nodes"]


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
        data = {name: ua.NodeId.from_string(f"{node.to_string()}.Data") for name, node in robots.items()}
        for one in await variables_below(client.batches, data):
            name = one.path[-1]
            if name in CHARGES:
                place = CHARGES.index(name), name, one.node
                best[one.root] = min(best.get(one.root, place), place, key=lambda rank: rank[0])
        found = sorted(best.items())
        details = await value_details(client.batches, [node for _, (_, _, node) in found])
    return [
        ChargeNode(robot, name, node.to_string(), detail.unit)
        for (robot, (_, name, node)), detail in zip(found, details, strict=True)
    ]
