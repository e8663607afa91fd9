"""DataSetMetaData made and read: fields, their type codes and their properties."""

from __future__ import annotations

import json
import math
import uuid
import zlib
from collections.abc import Mapping
from typing import Any, Final

from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, QualifiedName
from ua_fleet.wire.messages import DataSetMetaData, FieldMetaData

__all__ = [
    "MAX_AGE",
    "NODE_ONLY",
    "PropertyValue",
    "field_property",
    "fields_version",
    "first_property",
    "make_field",
    "max_age_s",
    "type_code",
    "type_codes",
    "with_max_age",
]

MAX_AGE: Final = "MaxAge"
"""Property of a DataSet's first field: for how long a value counts as one of now after it was read, a Duration (ms)."""

NODE_ONLY: Final = "NodeOnly"
"""Property of a DataSet's first field: the data is for the server's nodes and has no form in a robot's space."""

PropertyValue = bool | int | float | str | tuple[float, ...]
"""What a property of ours may hold."""

_FIELD_IDS: Final = uuid.UUID("6f0d5c0e-9d3a-5d5a-8f43-0c3f6a1f7b11")
"""Name space of our DataSetFieldIds: the same field name always has the same id."""
_PROPERTY_TYPES: Final[dict[type, int]] = {
    bool: BuiltinType.BOOLEAN,
    int: BuiltinType.INT64,
    float: BuiltinType.DOUBLE,
    str: BuiltinType.STRING,
    tuple: BuiltinType.DOUBLE | ARRAY,
}


def make_field(
    name: str,
    builtin_type: int,
    *,
    array: bool = False,
    properties: Mapping[str, PropertyValue] | None = None,
) -> FieldMetaData:
    """One field of a DataSet; the properties' names stand in namespace 0.

    Args:
        name: name of the field, unique in its DataSet.
        builtin_type: type of the field, or of its elements.
        array: whether the field is an array of one dimension and any length.
        properties: what another space needs to know, e.g. `{"RosType": "std_msgs/Float64"}`.
    """
    return FieldMetaData(
        name=name,
        builtin_type=int(builtin_type),
        value_rank=1 if array else -1,
        array_dimensions=(0,) if array else (),
        data_set_field_id=uuid.uuid5(_FIELD_IDS, name),
        properties=tuple(
            (QualifiedName(0, key), int(_PROPERTY_TYPES[type(value)]), value)
            for key, value in (properties or {}).items()
        ),
    )


def field_property(field: FieldMetaData, name: str) -> Any | None:
    """The value of a field's property in any namespace, or None."""
    return next((value for key, _, value in field.properties if key.name == name), None)


def first_property(metadata: DataSetMetaData, name: str) -> Any | None:
    """The value of the property `name` of the first field that has it, or None."""
    values = (field_property(field, name) for field in metadata.fields)
    return next((value for value in values if value is not None), None)


def type_code(field: FieldMetaData) -> int:
    """The type code that a value of the field has: the encoding byte of its Variant."""
    if field.value_rank < 1:
        return field.builtin_type
    return field.builtin_type | (ARRAY if field.value_rank == 1 else ARRAY | DIMENSIONS)


def type_codes(fields: tuple[FieldMetaData, ...]) -> tuple[int, ...]:
    """The type codes of all fields."""
    return tuple(type_code(field) for field in fields)


def fields_version(request: tuple[FieldMetaData, ...], response: tuple[FieldMetaData, ...]) -> int:
    """A version of an Action's fields that only their names, order and types make: the same after each restart, and on
    both sides. Never 0.
    """
    said = [[[field.name, type_code(field)] for field in fields] for fields in (request, response)]
    return zlib.crc32(json.dumps(said).encode()) or 1


def with_max_age(fields: tuple[FieldMetaData, ...], max_age_s: float | None) -> tuple[FieldMetaData, ...]:
    """The fields with this maximum age; None is none."""
    if not fields:
        return fields
    properties = tuple([known for known in fields[0].properties if known[0].name != MAX_AGE])
    if max_age_s is not None:
        properties += ((QualifiedName(0, MAX_AGE), int(BuiltinType.DOUBLE), max_age_s * 1000),)
    return (fields[0]._replace(properties=properties), *fields[1:])


def max_age_s(fields: tuple[FieldMetaData, ...]) -> float | None:
    """The maximum age that a publisher announces; None for none, and for what is no time."""
    age_ms = field_property(fields[0], MAX_AGE) if fields else None
    if isinstance(age_ms, bool) or not isinstance(age_ms, int | float) or not 0 < age_ms < math.inf:
        return None
    return age_ms / 1000
