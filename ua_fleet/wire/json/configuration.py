"""The structures of discovery as JSON objects; those of ExtensionObjects are named by their DataTypes."""

from __future__ import annotations

from typing import Final

from ua_fleet.wire.discovery_structures import Forms, KnownStructure, make_structures
from ua_fleet.wire.json.metadata import META_DATA, PROPERTIES
from ua_fleet.wire.json.records import (
    BOOLEAN,
    BYTE,
    BYTE_STRING,
    DOUBLE,
    ENUMERATION,
    LOCALIZED_TEXT,
    NODE_ID,
    STRING,
    TEXT,
    UINT16,
    UINT32,
    VARIANT,
    Member,
    Record,
    array,
    extension,
    nested,
    record,
)

__all__ = [
    "ACTION_METHOD",
    "ACTION_TARGET",
    "APPLICATION_DESCRIPTION",
    "CONNECTION",
    "ENDPOINT_DESCRIPTION",
]


def _structure(kind: type, **members: Member | Record) -> Record:
    return record(kind, **{name: nested(each) if isinstance(each, Record) else each for name, each in members.items()})


def _extension(*known: KnownStructure[Member | Record]) -> Member:
    return extension({each.data_type: each.form for each in known if isinstance(each.form, Record)})


_MADE: Final = make_structures(
    Forms[Member | Record](
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
        properties=PROPERTIES,
        structure=_structure,
        array=array,
        extension=_extension,
    )
)
APPLICATION_DESCRIPTION: Final = _MADE.application_description
ENDPOINT_DESCRIPTION: Final = _MADE.endpoint_description
CONNECTION: Final = _MADE.connection
ACTION_TARGET: Final = _MADE.action_target
ACTION_METHOD: Final = _MADE.action_method
