"""Annotates the structures that discovery messages carry.

Announcements are decoded by shapes (`structure.py`), which are walked through here. DataSetMetaData has a decoder of
its own; its layout stands here as a table.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from ua_fleet.dissect.spans import MessageWalk
from ua_fleet.values import BuiltinType, NodeId
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.structure import Elements, Record, Shape, StructureChoice
from ua_fleet.wire.variant import SMALLEST

__all__ = ["walk_fields", "walk_shape"]


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


NAMES: Final = {
    "metadata": "DataSetMetaData",
    "status": "StatusCode",
    "statuses": "StatusCodes",
    "publishing_interval_ms": "PublishingInterval",
    "keep_alive_time_ms": "KeepAliveTime",
    "message_receive_timeout_ms": "MessageReceiveTimeout",
    "url": "Url",
}
"""Names of the specification that are not ours in PascalCase."""

EXTENSION_ENCODINGS: Final = {0: "no body", 1: "a ByteString", 2: "an XmlElement"}


def walk_fields(walk: MessageWalk, names: tuple[str, ...], shapes: tuple[Shape, ...], before: str = "") -> None:
    """Note the fields of a structure, by our names for them."""
    for name, shape in zip(names, shapes, strict=True):
        called = NAMES.get(name) or "".join(word.capitalize() for word in name.split("_"))
        walk_shape(walk, f"{before}{called}", shape)


def walk_shape(walk: MessageWalk, name: str, shape: Shape) -> None:
    """Note every part of what a shape decodes."""
    form = shape.form
    if isinstance(form, Record):
        walk_fields(walk, form.names, form.fields, f"{name}.")
    elif isinstance(form, Elements):
        for index in range(walk.length(f"{name}.ArrayLength", form.of.smallest, "elements") or 0):
            walk_shape(walk, f"{name}[{index}]", form.of)
    elif isinstance(form, StructureChoice):
        _walk_extension_object(walk, name, form)
    elif form is None:  # the one that has no shape
        _walk_part(walk, name, DATA_SET_META_DATA)
    else:
        walk.value(name, form)


def _walk_extension_object(walk: MessageWalk, name: str, choice: StructureChoice) -> None:
    type_id: NodeId = walk.value(f"{name}.TypeId", BuiltinType.NODE_ID)
    encoding = walk.read(f"{name}.Encoding", Cursor.byte, lambda kind: EXTENSION_ENCODINGS.get(kind, "reserved"))
    known = (
        choice.known.get(type_id.identifier) if type_id.namespace == 0 and isinstance(type_id.identifier, int) else None
    )
    if encoding == 1 and known is not None:
        walk_shape(walk.part(walk.length(f"{name}.Length", 1, "bytes") or 0), name, known[1])
    elif encoding:
        walk.value(f"{name}.Body", BuiltinType.BYTE_STRING if encoding == 1 else BuiltinType.XML_ELEMENT)


def _walk_part(walk: MessageWalk, name: str, kind: Kind) -> None:
    if isinstance(kind, Array):
        for index in range(walk.length(f"{name}.ArrayLength", smallest(kind.of), "elements") or 0):
            _walk_part(walk, f"{name}[{index}]", kind.of)
    elif isinstance(kind, BuiltinType):
        walk.value(name, kind)
    else:
        for part, part_kind in kind:
            _walk_part(walk, f"{name}.{part}", part_kind)


def smallest(kind: Kind) -> int:
    """Bytes that something takes at least."""
    if isinstance(kind, Array):
        return 4
    return SMALLEST[kind] if isinstance(kind, BuiltinType) else sum(smallest(part) for _, part in kind)
