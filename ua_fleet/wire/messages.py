"""Decoded Part 14 messages: what the codec returns and what it takes (OPC 10000-14 7.2.4).

All of them are plain tuples: building one costs a fraction of a microsecond, and nothing can change them.
"""

from __future__ import annotations

import uuid
from enum import IntEnum
from typing import Any, NamedTuple

from ua_fleet.values import LocalizedText, NodeId, QualifiedName
from ua_fleet.wire.descriptions import EnumerationDescription, SimpleTypeDescription, StructureDescription

__all__ = [
    "Announcement",
    "ConfigurationVersion",
    "DataSetMessage",
    "DataSetMetaData",
    "FieldEncoding",
    "FieldMetaData",
    "FrameKind",
    "MetaDataAnnouncement",
    "NetworkMessage",
    "Probe",
    "ProbeKind",
    "PublisherIdType",
]


class PublisherIdType(IntEnum):
    """Bits 0-2 of ExtendedFlags1 (OPC 10000-14 table 154)."""

    BYTE = 0
    UINT16 = 1
    UINT32 = 2
    UINT64 = 3
    STRING = 4


class FrameKind(IntEnum):
    """DataSetMessage type: bits 0-3 of DataSetFlags2 (OPC 10000-14 table 158)."""

    KEY = 0
    DELTA = 1
    EVENT = 2
    KEEP_ALIVE = 3


class FieldEncoding(IntEnum):
    """Bits 1-2 of DataSetFlags1 (OPC 10000-14 table 158)."""

    VARIANT = 0
    RAW_DATA = 1
    DATA_VALUE = 2


class DataSetMessage(NamedTuple):
    """One DataSetMessage. `types[i]` is the type code of `values[i]` (see `ua_fleet.values`).

    With DataValue encoding `values` still holds the bare values, and the five `field_*` tuples hold what stood beside
    them: `field_status` always, the others where at least one field has such a part. A field that had no value has type
    code 0. In Variant encoding a field may be a StatusCode in place of its value (a Bad field); it stays so here. A key
    frame without fields is a heartbeat (OPC 10000-14 7.2.4.5.5).
    """

    data_set_writer_id: int
    kind: int = FrameKind.KEY
    types: tuple[int, ...] = ()
    values: tuple[Any, ...] = ()
    sequence_number: int | None = None
    timestamp: int | None = None
    """Ticks; the SourceTimestamp of all fields."""
    picoseconds: int | None = None
    status: int | None = None
    """All 32 bits of a StatusCode of which only the upper 16 travel; None where the header has none."""
    major_version: int | None = None
    minor_version: int | None = None
    encoding: int = FieldEncoding.VARIANT
    indices: tuple[int, ...] | None = None
    """Field indices of a delta frame."""
    field_status: tuple[int, ...] | None = None
    field_source_timestamps: tuple[int | None, ...] | None = None
    field_server_timestamps: tuple[int | None, ...] | None = None
    field_source_picoseconds: tuple[int | None, ...] | None = None
    field_server_picoseconds: tuple[int | None, ...] | None = None
    raw: bytes | None = None
    """The undecoded fields of a RawData message, or a payload of JSON as text: only metadata tells their types."""
    valid: bool = True
    """Bit 0 of DataSetFlags1: a message without it is to be ignored."""


class NetworkMessage(NamedTuple):
    """One UADP NetworkMessage that carries data. A part that is None is absent from the bytes."""

    publisher_id: int | str | None = None
    publisher_id_type: int = PublisherIdType.UINT16
    data_set_class_id: uuid.UUID | None = None
    writer_group_id: int | None = None
    group_version: int | None = None
    network_message_number: int | None = None
    sequence_number: int | None = None
    timestamp: int | None = None
    picoseconds: int | None = None
    promoted_types: tuple[int, ...] | None = None
    promoted_values: tuple[Any, ...] | None = None
    payload_header: bool = True
    messages: tuple[DataSetMessage, ...] = ()


class ConfigurationVersion(NamedTuple):
    """VersionTime of the last incompatible (major) and of any (minor) change (OPC 10000-14 6.2.3.2.6)."""

    major: int
    minor: int


class FieldMetaData(NamedTuple):
    """FieldMetaData (OPC 10000-14 6.2.3.2.4)."""

    name: str
    builtin_type: int
    description: LocalizedText = LocalizedText(None)
    field_flags: int = 0
    data_type: NodeId | None = None
    """None stands for the built-in type's own NodeId."""
    value_rank: int = -1
    """-1 scalar, 1 one dimension, n dimensions."""
    array_dimensions: tuple[int, ...] = ()
    max_string_length: int = 0
    data_set_field_id: uuid.UUID = uuid.UUID(int=0)
    properties: tuple[tuple[QualifiedName, int, Any], ...] = ()
    """(key, type code, value) of each property."""


class DataSetMetaData(NamedTuple):
    """DataSetMetaDataType (OPC 10000-14 6.2.3.2.3)."""

    name: str
    fields: tuple[FieldMetaData, ...]
    configuration_version: ConfigurationVersion
    description: LocalizedText = LocalizedText(None)
    data_set_class_id: uuid.UUID = uuid.UUID(int=0)
    namespaces: tuple[str, ...] = ()
    """URIs of the namespaces that NodeIds and names here refer to; the first has the index 1."""
    structures: tuple[StructureDescription, ...] = ()
    enumerations: tuple[EnumerationDescription, ...] = ()
    simple_types: tuple[SimpleTypeDescription, ...] = ()


class ProbeKind(IntEnum):
    """InformationType of a probe (OPC 10000-14 table 179), and the one probe that has none."""

    FIND_APPLICATIONS = 0
    """A FindApplications probe (table 178), to all Publishers: who is there?"""
    ENDPOINTS = 1
    DATA_SET_META_DATA = 2
    DATA_SET_WRITER_CONFIGURATION = 3
    WRITER_GROUP_CONFIGURATION = 4
    PUBSUB_CONNECTIONS = 5


class Probe(NamedTuple):
    """A discovery probe addressed to one publisher; of the fields after `kind` each kind has its own."""

    publisher_id: int | str | None
    publisher_id_type: int
    kind: int
    data_set_writer_ids: tuple[int, ...] = ()
    """Of metadata and DataSetWriter configurations; an empty list asks for all of them."""
    writer_group_id: int = 0
    """Of a WriterGroup configuration (table 181); 0 asks for all of them."""
    transport_profile_uris: tuple[str, ...] = ()
    """Of PubSubConnections (table 182): only those with such a transport; an empty list asks for all."""
    include_writer_groups: bool = False
    include_data_set_writers: bool = False


class MetaDataAnnouncement(NamedTuple):
    """The DataSetMetaData of one DataSetWriter (OPC 10000-14 7.2.4.6.4)."""

    publisher_id: int | str | None
    publisher_id_type: int
    sequence_number: int
    data_set_writer_id: int
    metadata: DataSetMetaData
    status: int = 0


class Announcement(NamedTuple):
    """Application information of a kind that this edition does not know; `body` is what follows its SequenceNumber."""

    publisher_id: int | str | None
    publisher_id_type: int
    kind: int
    sequence_number: int
    body: bytes
