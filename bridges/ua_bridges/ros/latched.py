"""Sources whose robot keeps the last message for late subscribers: `latch` in ROS 1, transient local in ROS 2."""

from __future__ import annotations

from typing import Final

from ua_fleet.pubsub.metadata import field_property
from ua_fleet.values import BuiltinType, QualifiedName
from ua_fleet.wire.messages import FieldMetaData

__all__ = ["LATCHED", "is_latched", "mark_latched"]

LATCHED: Final = "RosLatched"
"""Property of a source whose robot publishes it so: late subscribers in other spaces get the last message too."""


def mark_latched(fields: tuple[FieldMetaData, ...]) -> tuple[FieldMetaData, ...]:
    """The fields with the property, which stands at the first one."""
    mark = (QualifiedName(0, LATCHED), int(BuiltinType.BOOLEAN), True)
    return (fields[0]._replace(properties=(*fields[0].properties, mark)), *fields[1:])


def is_latched(fields: tuple[FieldMetaData, ...]) -> bool:
    """Whether the source's robot keeps its last message for late subscribers."""
    return bool(fields) and field_property(fields[0], LATCHED) is True
