"""By whom a robot is held back from tasks, as Variables of its Object, and the Methods that all robots share."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from typing import Final

from asyncua import ua

from ua_fleet.endpoint.convert import data_value, raw_id
from ua_fleet.endpoint.node_builder import HAS_COMPONENT
from ua_fleet.fleet.model import RobotModel
from ua_fleet.nodes.node_factory import STANDARD, NodeFactory
from ua_fleet.nodes.nodeset import TYPES_INDEX
from ua_fleet.values import BuiltinType, Variant

__all__ = ["HOLD", "NOT_HELD", "RELEASE", "HoldNodes"]

HOLD: Final = raw_id(72051, TYPES_INDEX)
RELEASE: Final = raw_id(72052, TYPES_INDEX)
"""Methods of RobotType, which all robots share (OPC 10000-3 6.4.4.2)."""

NOT_HELD: Final = {
    "Held": Variant(int(BuiltinType.BOOLEAN), False),
    "HeldBy": Variant(int(BuiltinType.STRING), ""),
    "HeldSince": Variant(int(BuiltinType.DATETIME), None),
    "HeldReason": Variant(int(BuiltinType.STRING), ""),
}
"""The Variables of a robot that nobody holds."""


class HoldNodes:
    """Makes these nodes. The first values are the same objects for all robots, since nobody writes to them."""

    def __init__(self, parts: NodeFactory) -> None:
        self._parts = parts
        self._values = {
            name: data_value(one.type, one.value, 0, parts.now, parts.now) for name, one in NOT_HELD.items()
        }

    def add(self, robot: RobotModel, node: ua.NodeId) -> None:
        """Make the nodes of a robot below its Object."""
        for name, value in self._values.items():
            data_type = STANDARD["UtcTime"] if name == "HeldSince" else raw_id(NOT_HELD[name].type)
            self._parts.variable(robot.part(name), name, node, data_type, value)
        for method in (HOLD, RELEASE):
            self._parts.builder.add_reference(node, HAS_COMPONENT, method)
