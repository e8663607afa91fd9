"""What has come and gone in the address space, as GeneralModelChangeEvents (OPC 10000-3 9.32)."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Sequence
from enum import IntFlag
from typing import Any, Final

import structlog
from asyncua import ua
from asyncua.ua.ua_binary import struct_to_binary

from ua_fleet.endpoint.convert import node_id, raw_id
from ua_fleet.endpoint.stack import ObjectIds, ns0
from ua_fleet.fleet.changes import CapacitiesChanged
from ua_fleet.fleet.model import RobotModel
from ua_fleet.nodes.events import ServerEvents
from ua_fleet.nodes.nodeset import TYPES_INDEX, TypeId
from ua_fleet.values import ARRAY, BuiltinType, ExtensionObject, NodeId, Variant

__all__ = ["Verb", "tell_capacities", "tell_model_change"]

_log: Any = structlog.get_logger("ua_fleet.server")

_TYPE: Final = ns0(ObjectIds.GeneralModelChangeEventType)
_ENCODING: Final = NodeId(0, int(ObjectIds.ModelChangeStructureDataType_Encoding_DefaultBinary))


class Verb(IntFlag):
    """What has happened to a node (OPC 10000-5 12.16)."""

    NODE_ADDED = 1
    NODE_DELETED = 2
    REFERENCE_ADDED = 4
    REFERENCE_DELETED = 8


def tell_capacities(
    events: ServerEvents, change: CapacitiesChanged, gained: Sequence[str], lost: Sequence[str], ticks: int
) -> None:
    """Emit the events of capacities that a robot has gained or lost."""
    for verb, names in ((Verb.REFERENCE_ADDED, gained), (Verb.REFERENCE_DELETED, lost)):
        if names:
            what = "can do now" if verb is Verb.REFERENCE_ADDED else "cannot do any more"
            why = "; ".join(dict.fromkeys(change.lacks[name] for name in names if name in change.lacks))
            text = f"robot {change.robot.name} {what}: {', '.join(names)}{f' ({why})' if why else ''}"
            _log.info(text, robot=change.robot.name)
            _tell(events, change.robot, verb, text, ticks)


def tell_model_change(events: ServerEvents, robot: RobotModel, verb: Verb, ticks: int) -> None:
    """Emit the event of a robot that has come or gone."""
    what = "is one of the fleet now" if verb is Verb.NODE_ADDED else "is gone"
    _tell(events, robot, verb, f"robot {robot.name} {what}", ticks)


def _tell(events: ServerEvents, robot: RobotModel, verb: Verb, text: str, ticks: int) -> None:
    change: Any = ua.ModelChangeStructureDataType(
        node_id(robot.key), raw_id(TypeId.ROBOT.value, TYPES_INDEX), ua.Byte(verb.value)
    )
    changes = (ExtensionObject(_ENCODING, struct_to_binary(change)),)
    events.emit(
        _TYPE,
        source=NodeId(0, int(ObjectIds.Server)),
        source_name="Server",
        message=text,
        severity=100,
        ticks=ticks,
        fields={"Changes": Variant(int(BuiltinType.EXTENSION_OBJECT | ARRAY), changes)},
    )
