"""The Object `Teleoperation` of a robot that people drive by hand; its id is that of what the bridge says of it."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from typing import Final

from asyncua import ua

from ua_fleet.endpoint.convert import data_value, node_id, raw_id
from ua_fleet.endpoint.node_builder import HAS_COMPONENT
from ua_fleet.nodes.node_factory import STANDARD, NodeFactory
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId
from ua_fleet.teleoperation.messages import SETPOINT_DROPS
from ua_fleet.teleoperation.model import LEASE_S, TeleoperationModel
from ua_fleet.topics import Topic
from ua_fleet.values import ARRAY, BuiltinType, NodeId, QualifiedName, Variant

__all__ = ["ACQUIRE", "DRIVE", "RELEASE", "RENEW", "STATUS_VARIABLES", "TeleoperationNodes", "drop_name", "key_of"]

ACQUIRE: Final = raw_id(72071, TYPES_INDEX)
RENEW: Final = raw_id(72072, TYPES_INDEX)
RELEASE: Final = raw_id(72073, TYPES_INDEX)
DRIVE: Final = raw_id(72074, TYPES_INDEX)
"""Methods of TeleoperationType, which all robots share (OPC 10000-3 6.4.4.2)."""

_UINT32: Final = int(BuiltinType.UINT32)
_STRINGS: Final = int(BuiltinType.STRING | ARRAY)
_DOUBLES: Final = int(BuiltinType.DOUBLE | ARRAY)

STATUS_VARIABLES: Final = {
    "State": int(BuiltinType.INT32),
    "Holder": int(BuiltinType.STRING),
    "HeldSince": int(BuiltinType.DATETIME),
    "Lease": _UINT32,
    "Counter": _UINT32,
    "LastNumber": _UINT32,
    "LastEnd": int(BuiltinType.STRING),
    "Output": _DOUBLES,
}
"""What the bridge says, with the types of the values."""


def key_of(status: Topic, name: str) -> NodeId:
    """A node below the Object whose numeric id is that of `status`."""
    return NodeId(status.ns, f"{status.id}.{name}")


def drop_name(cause: str) -> str:
    """The part of a NodeId that counts a cause."""
    return f"Drops.{cause}"


class TeleoperationNodes:
    """Makes these nodes."""

    def __init__(self, parts: NodeFactory) -> None:
        self._parts = parts

    def add(self, model: TeleoperationModel, robot: ua.NodeId) -> None:
        """Make the nodes of a robot below its Object."""
        status = model.status
        parts = self._parts.within(status.ns)
        node = node_id(NodeId(status.ns, status.id))
        parts.builder.add_object(
            node, QualifiedName(TYPES_INDEX, "Teleoperation"), robot, parts.types[TypeId.TELEOPERATION]
        )
        for method in (ACQUIRE, RENEW, RELEASE, DRIVE):
            parts.builder.add_reference(node, HAS_COMPONENT, method)
        of_types = {"State": parts.types[TypeId.TELEOPERATION_STATE], "HeldSince": STANDARD["UtcTime"]}
        for name, kind in STATUS_VARIABLES.items():
            data_type = of_types.get(name) or raw_id(kind & 0x3F)
            parts.variable(key_of(status, name), name, node, data_type, parts.waiting, is_array=bool(kind & ARRAY))
        none = data_value(_UINT32, 0, 0, parts.now, parts.now)
        parts.variable(key_of(status, "Refused"), "Refused", node, raw_id(_UINT32), none)
        drops = parts.folder(f"{status.id}.Drops", "Drops", node)
        for cause in SETPOINT_DROPS:
            key = key_of(status, drop_name(cause))
            parts.variable(key, cause, drops, raw_id(_UINT32), parts.waiting, own_name=True)
        for name, value in _properties(model).items():
            parts.property(f"{status.id}.{name}", name, node, value.type, value.value)


def _properties(model: TeleoperationModel) -> dict[str, Variant]:
    limits = [each for _, each in model.axes]
    units = [unit or "" for unit in model.units] or [""] * len(limits)
    times_s = {
        "DeadmanMs": model.deadman_s,
        "LeaseMs": LEASE_S,
        "RobotTimeoutMs": model.robot_timeout_s,
        "PeriodMs": model.period_s,
        "StopMs": model.stop_s,
    }
    return {
        "Axes": Variant(_STRINGS, [name for name, _ in model.axes]),
        "Units": Variant(_STRINGS, units),
        "Speed": Variant(_DOUBLES, [each.speed for each in limits]),
        "Acceleration": Variant(_DOUBLES, [each.acceleration for each in limits]),
        "Deceleration": Variant(_DOUBLES, [each.deceleration for each in limits]),
        "Jerk": Variant(_DOUBLES, [each.jerk for each in limits]),
        **{name: Variant(_UINT32, round(time_s * 1000)) for name, time_s in times_s.items()},
    }
