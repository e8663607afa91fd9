"""The layouts of the structures that discovery messages carry, as tables: names and types in their order."""

from __future__ import annotations

from typing import Final, NamedTuple

from ua_fleet.values import BuiltinType
from ua_fleet.wire.spans import Walk
from ua_fleet.wire.variant import SMALLEST

__all__ = ["DATA_SET_META_DATA", "Array", "Structure", "walk_structure"]


class Array(NamedTuple):
    """An Int32 count and so many elements."""

    of: Kind


Structure = tuple[tuple[str, "Kind"], ...]
Kind = BuiltinType | Array | Structure

_STRING: Final = BuiltinType.STRING
_TEXT: Final = BuiltinType.LOCALIZED_TEXT
_NODE_ID: Final = BuiltinType.NODE_ID
_NAME: Final = BuiltinType.QUALIFIED_NAME
_INT32: Final = BuiltinType.INT32
_UINT32: Final = BuiltinType.UINT32
_BYTE: Final = BuiltinType.BYTE

KEY_VALUE_PAIR: Final[Structure] = (("Key", _NAME), ("Value", BuiltinType.VARIANT))

STRUCTURE_FIELD: Final[Structure] = (
    ("Name", _STRING),
    ("Description", _TEXT),
    ("DataType", _NODE_ID),
    ("ValueRank", _INT32),
    ("ArrayDimensions", Array(_UINT32)),
    ("MaxStringLength", _UINT32),
    ("IsOptional", _BYTE),
)
STRUCTURE_DESCRIPTION: Final[Structure] = (
    ("DataTypeId", _NODE_ID),
    ("Name", _NAME),
    ("DefaultEncodingId", _NODE_ID),
    ("BaseDataType", _NODE_ID),
    ("StructureType", _INT32),
    ("Fields", Array(STRUCTURE_FIELD)),
)
ENUM_FIELD: Final[Structure] = (
    ("Value", BuiltinType.INT64),
    ("DisplayName", _TEXT),
    ("Description", _TEXT),
    ("Name", _STRING),
)
ENUM_DESCRIPTION: Final[Structure] = (
    ("DataTypeId", _NODE_ID),
    ("Name", _NAME),
    ("Fields", Array(ENUM_FIELD)),
    ("BuiltInType", _BYTE),
)
SIMPLE_TYPE_DESCRIPTION: Final[Structure] = (
    ("DataTypeId", _NODE_ID),
    ("Name", _NAME),
    ("BaseDataType", _NODE_ID),
    ("BuiltInType", _BYTE),
)
FIELD_META_DATA: Final[Structure] = (
    ("Name", _STRING),
    ("Description", _TEXT),
    ("FieldFlags", BuiltinType.UINT16),
    ("BuiltInType", _BYTE),
    ("DataType", _NODE_ID),
    ("ValueRank", _INT32),
    ("ArrayDimensions", Array(_UINT32)),
    ("MaxStringLength", _UINT32),
    ("DataSetFieldId", BuiltinType.GUID),
    ("Properties", Array(KEY_VALUE_PAIR)),
)
DATA_SET_META_DATA: Final[Structure] = (
    ("Namespaces", Array(_STRING)),
    ("StructureDataTypes", Array(STRUCTURE_DESCRIPTION)),
    ("EnumDataTypes", Array(ENUM_DESCRIPTION)),
    ("SimpleDataTypes", Array(SIMPLE_TYPE_DESCRIPTION)),
    ("Name", _STRING),
    ("Description", _TEXT),
    ("Fields", Array(FIELD_META_DATA)),
    ("DataSetClassId", BuiltinType.GUID),
    ("ConfigurationVersion.MajorVersion", _UINT32),
    ("ConfigurationVersion.MinorVersion", _UINT32),
)
"""DataSetMetaDataType (OPC 10000-14 6.2.3.2.3); the structures above are OPC 10000-5 12.30 to 12.34."""


def walk_structure(walk: Walk, name: str, structure: Structure) -> None:
    """Note every part of a structure."""
    for part, kind in structure:
        _walk_part(walk, f"{name}.{part}" if name else part, kind)


def _walk_part(walk: Walk, name: str, kind: Kind) -> None:
    if isinstance(kind, Array):
        for index in range(walk.length(f"{name}.ArrayLength", smallest(kind.of), "elements") or 0):
            _walk_part(walk, f"{name}[{index}]", kind.of)
    elif isinstance(kind, BuiltinType):
        walk.value(name, kind)
    else:
        walk_structure(walk, name, kind)


def smallest(kind: Kind) -> int:
    """Bytes that something takes at least."""
    if isinstance(kind, Array):
        return 4
    return SMALLEST[kind] if isinstance(kind, BuiltinType) else sum(smallest(part) for _, part in kind)
