"""Structures of PubSub's information model as values: bytes under the NodeIds of their Default Binary encodings."""

from __future__ import annotations

import uuid
from collections.abc import Iterable
from typing import Final, NamedTuple

from ua_fleet.values import BuiltinType, ExtensionObject, NodeId
from ua_fleet.wire.discovered import KeyValuePair
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData
from ua_fleet.wire.metadata import encode_metadata
from ua_fleet.wire.structure import (
    DOUBLE,
    ENUMERATION,
    GUID,
    NODE_ID,
    QUALIFIED_NAME,
    STRING,
    UINT32,
    VARIANT,
    Shape,
    array,
    structure,
)

__all__ = [
    "FieldTarget",
    "PublishedVariable",
    "field_target",
    "key_value_pairs",
    "metadata_value",
    "published_variable",
    "version_value",
]

VALUE: Final = 13
"""The Attribute Value (OPC 10000-6 A.1)."""
LAST_USABLE_VALUE: Final = 1
"""OverrideValueHandling: where there is no new value the last one stays, and is not Good (6.2.10.2.4)."""
_META_DATA: Final = NodeId(0, 124)
_PUBLISHED_VARIABLE: Final = NodeId(0, 14323)
_KEY_VALUE_PAIR: Final = NodeId(0, 14846)
_VERSION: Final = NodeId(0, 14847)
_FIELD_TARGET: Final = NodeId(0, 14848)


class PublishedVariable(NamedTuple):
    """PublishedVariableDataType (6.2.3.7.1): it is published when it changes, without a deadband."""

    variable: NodeId
    attribute_id: int = VALUE
    sampling_interval_hint_ms: float = -1.0
    deadband_type: int = 0
    deadband_value: float = 0.0
    index_range: str | None = None
    substitute: None = None
    properties: tuple[KeyValuePair, ...] = ()


class FieldTarget(NamedTuple):
    """FieldTargetDataType (6.2.10.2.3)."""

    data_set_field_id: uuid.UUID
    receiver_index_range: str | None
    target: NodeId
    attribute_id: int = VALUE
    write_index_range: str | None = None
    override_value_handling: int = LAST_USABLE_VALUE
    override_value: None = None


_NAME_AND_VALUE: Final = structure(KeyValuePair, QUALIFIED_NAME, VARIANT)


def _encode_null(out: bytearray, _value: None) -> None:
    out.append(0)


_NULL_VARIANT: Final = VARIANT._replace(encode=_encode_null)
_VARIABLE_SHAPE: Final = structure(
    PublishedVariable, NODE_ID, UINT32, DOUBLE, UINT32, DOUBLE, STRING, _NULL_VARIANT, array(QUALIFIED_NAME)
)
_TARGET_SHAPE: Final = structure(FieldTarget, GUID, STRING, NODE_ID, UINT32, STRING, ENUMERATION, _NULL_VARIANT)


def _value(type_id: NodeId, shape: Shape, content: object) -> ExtensionObject:
    body = bytearray()
    shape.encode(body, content)
    return ExtensionObject(type_id, bytes(body))


def metadata_value(metadata: DataSetMetaData) -> ExtensionObject:
    """A DataSetMetaData."""
    body = bytearray()
    encode_metadata(body, metadata)
    return ExtensionObject(_META_DATA, bytes(body))


def version_value(version: ConfigurationVersion) -> ExtensionObject:
    """A ConfigurationVersion."""
    return _value(_VERSION, structure(ConfigurationVersion, UINT32, UINT32), version)


def key_value_pairs(pairs: Iterable[KeyValuePair]) -> list[ExtensionObject]:
    """Properties; without those whose type is none of today: they can be read as bytes, and not be written."""
    known = [pair for pair in pairs if pair.value.type & 0x3F <= BuiltinType.DIAGNOSTIC_INFO]
    return [_value(_KEY_VALUE_PAIR, _NAME_AND_VALUE, pair) for pair in known]


def published_variable(variable: NodeId) -> ExtensionObject:
    """A Variable whose value a field of a DataSet has."""
    return _value(_PUBLISHED_VARIABLE, _VARIABLE_SHAPE, PublishedVariable(variable))


def field_target(field_id: uuid.UUID, variable: NodeId) -> ExtensionObject:
    """The Variable that a field of a DataSet is written to."""
    return _value(_FIELD_TARGET, _TARGET_SHAPE, FieldTarget(field_id, None, variable))
