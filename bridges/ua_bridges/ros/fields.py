"""The metadata of flat fields, and the message type that stands for metadata."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from ua_bridges.ros.leaves import EMPTY_FIELD, leaves_of
from ua_bridges.ros.schema import MessageSchema, compact_definition
from ua_fleet.pubsub.metadata import field_property, make_field, type_code, with_max_age
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType
from ua_fleet.wire.messages import DataSetMetaData, FieldMetaData

__all__ = ["fields_of", "is_same_type", "ros_type_of", "std_type_for"]

_SCALARS: Final = {
    BuiltinType.BOOLEAN: "Bool",
    BuiltinType.SBYTE: "Int8",
    BuiltinType.BYTE: "UInt8",
    BuiltinType.INT16: "Int16",
    BuiltinType.UINT16: "UInt16",
    BuiltinType.INT32: "Int32",
    BuiltinType.UINT32: "UInt32",
    BuiltinType.INT64: "Int64",
    BuiltinType.UINT64: "UInt64",
    BuiltinType.FLOAT: "Float32",
    BuiltinType.DOUBLE: "Float64",
    BuiltinType.STRING: "String",
}
_WITHOUT_ARRAY: Final = frozenset({BuiltinType.BOOLEAN, BuiltinType.STRING})


def fields_of(schema: MessageSchema, ros_type: str, definition: str | None = None) -> tuple[FieldMetaData, ...]:
    """The metadata of a message type's fields.

    Args:
        schema: the message type.
        ros_type: `pkg/Name`, for the property RosType of the first field.
        definition: the ROS 1 definition text, for its property RosDefinition (without comments).
    """
    properties = {"RosType": ros_type}
    if definition is not None:
        properties["RosDefinition"] = compact_definition(definition)
    fields = [(leaf.name, leaf.builtin, leaf.is_array) for leaf in leaves_of(schema)]
    if not fields:
        fields = [(EMPTY_FIELD, BuiltinType.BOOLEAN, False)]
    return tuple(
        make_field(name, builtin, array=array, properties={} if index else properties)
        for index, (name, builtin, array) in enumerate(fields)
    )


def std_type_for(code: int) -> str | None:
    """The std_msgs type that carries a single value of space 0, or None where ROS has none.

    Arrays go into `<Type>MultiArray` with an empty layout; a ByteString into `UInt8MultiArray`.
    """
    if code & DIMENSIONS:
        return None
    builtin = BuiltinType(code & 0x3F)
    array = bool(code & ARRAY)
    if builtin is BuiltinType.BYTE_STRING and not array:
        return "std_msgs/UInt8MultiArray"
    name = _SCALARS.get(builtin)
    if name is None or (array and builtin in _WITHOUT_ARRAY):
        return None
    return f"std_msgs/{name}MultiArray" if array else f"std_msgs/{name}"


def ros_type_of(fields: Sequence[FieldMetaData]) -> tuple[str, str | None, tuple[str, ...]] | None:
    """The type to publish another space's data with: RosType, RosDefinition if known, and its fields' flat names.

    Without the property RosType (data of space 0) it is the std_msgs type of the single field, whose flat name is
    `data` then. None when there is no such type.
    """
    if not fields:
        return None
    ros_type = field_property(fields[0], "RosType")
    if isinstance(ros_type, str):
        definition = field_property(fields[0], "RosDefinition")
        return ros_type, definition if isinstance(definition, str) else None, tuple(field.name for field in fields)
    first = fields[0]
    std_type = std_type_for(type_code(first)) if len(fields) == 1 else None
    return (std_type, None, ("data",)) if std_type else None


def is_same_type(before: DataSetMetaData, after: DataSetMetaData) -> bool:
    """Whether what is published for one metadata may go on for the other: a maximum age is learned as messages come."""
    return before is after or with_max_age(before.fields, None) == with_max_age(after.fields, None)
