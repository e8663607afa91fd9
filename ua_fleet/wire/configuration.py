"""The structures of discovery as bytes; those of ExtensionObjects are named by their Default Binary encodings."""

from __future__ import annotations

from typing import Final

from ua_fleet.wire import discovered as d
from ua_fleet.wire.discovery_structures import Forms, KnownStructure, make_structures
from ua_fleet.wire.metadata import decode_metadata, encode_metadata
from ua_fleet.wire.structure import (
    BOOLEAN,
    BYTE,
    BYTE_STRING,
    DOUBLE,
    ENUMERATION,
    LOCALIZED_TEXT,
    NODE_ID,
    QUALIFIED_NAME,
    STRING,
    TEXT,
    UINT16,
    UINT32,
    VARIANT,
    Shape,
    array,
    extension,
    structure,
)

__all__ = [
    "ACTION_METHOD",
    "ACTION_TARGET",
    "ADDRESS",
    "APPLICATION_DESCRIPTION",
    "CONNECTION",
    "ENDPOINT_DESCRIPTION",
    "META_DATA",
    "WRITER_GROUP",
]

SMALLEST_META_DATA: Final = 49

META_DATA: Final = Shape(SMALLEST_META_DATA, decode_metadata, encode_metadata)


def _structure(kind: type, **members: Shape) -> Shape:
    return structure(kind, *members.values())


def _extension(*known: KnownStructure[Shape]) -> Shape:
    return extension({each.encoding: (each.kind, each.form) for each in known})


_MADE: Final = make_structures(
    Forms(
        boolean=BOOLEAN,
        byte=BYTE,
        uint16=UINT16,
        uint32=UINT32,
        double=DOUBLE,
        enumeration=ENUMERATION,
        string=STRING,
        text=TEXT,
        byte_string=BYTE_STRING,
        node_id=NODE_ID,
        localized_text=LOCALIZED_TEXT,
        variant=VARIANT,
        metadata=META_DATA,
        properties=array(structure(d.KeyValuePair, QUALIFIED_NAME, VARIANT)),
        structure=_structure,
        array=array,
        extension=_extension,
    )
)
APPLICATION_DESCRIPTION: Final = _MADE.application_description
ENDPOINT_DESCRIPTION: Final = _MADE.endpoint_description
ADDRESS: Final = _MADE.address
WRITER_GROUP: Final = _MADE.writer_group
CONNECTION: Final = _MADE.connection
ACTION_TARGET: Final = _MADE.action_target
ACTION_METHOD: Final = _MADE.action_method
