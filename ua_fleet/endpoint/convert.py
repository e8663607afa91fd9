"""Our values as asyncua's, and back."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any, Final

from asyncua import ua

from ua_fleet.values import (
    ARRAY,
    DIMENSIONS,
    BuiltinType,
    DataValue,
    ExpandedNodeId,
    ExtensionObject,
    LocalizedText,
    NodeId,
    QualifiedName,
    StatusCode,
    Variant,
    datetime_from_ticks,
    ticks_from_datetime,
)

__all__ = [
    "ExactDateTime",
    "Unrepresentable",
    "data_value",
    "exact_datetime",
    "fleet_value",
    "fleet_variant",
    "node_id",
    "raw_id",
    "ticks_of",
    "to_status",
    "to_variant",
]

_BUILTIN: Final = 0x3F
_TICKS_PER_MICROSECOND: Final = 10


class Unrepresentable(ValueError):
    """A value that asyncua cannot carry."""


def raw_id(identifier: Any, namespace: Any = 0) -> ua.NodeId:
    """A NodeId in asyncua's form; plain Python values serve, whatever its types say."""
    return ua.NodeId(identifier, namespace)


def node_id(key: NodeId) -> ua.NodeId:
    """A NodeId in asyncua's form."""
    return raw_id(key.identifier, key.namespace)


class ExactDateTime(datetime):
    """A time of asyncua's, which ends at microseconds, and what it is in ticks."""

    ticks: int


def exact_datetime(ticks: int) -> datetime:
    """What asyncua makes of ticks, such that `ticks_of` gives the same ticks again: values of the history have them."""
    time: datetime = ua.win_epoch_to_datetime(ticks)
    if not ticks % _TICKS_PER_MICROSECOND or ticks_of(time) != ticks - ticks % _TICKS_PER_MICROSECOND:
        return time
    exact = ExactDateTime.combine(time.date(), time.timetz())
    exact.ticks = ticks
    return exact


def ticks_of(time: Any) -> int:
    """A time of asyncua's in ticks; 0 where none is given, and for what lies before all times."""
    if isinstance(time, ExactDateTime):
        return time.ticks
    if not isinstance(time, datetime):
        return 0
    return max(0, ticks_from_datetime(time.replace(tzinfo=UTC) if time.tzinfo is None else time))


@lru_cache(maxsize=1024)
def to_status(code: int) -> ua.StatusCode:
    """A StatusCode in asyncua's form; one object for each code, which nobody changes."""
    return ua.StatusCode(ua.UInt32(code))


def _expanded(value: ExpandedNodeId) -> ua.ExpandedNodeId:
    identifier: Any = value.node_id.identifier
    namespace: Any = value.node_id.namespace
    uri: Any = value.namespace_uri
    server_index: Any = value.server_index
    return ua.ExpandedNodeId(identifier, namespace, NamespaceUri=uri, ServerIndex=server_index)


def _extension_object(value: ExtensionObject) -> ua.ExtensionObject:
    if not isinstance(value.body, bytes):
        raise Unrepresentable("a structure in XML")
    return ua.ExtensionObject(node_id(value.type_id), ua.ByteString(value.body))


def _nested(value: Variant) -> ua.Variant:
    return to_variant(value.type, value.value)


def _data_value(value: DataValue) -> ua.DataValue:
    inner = value.variant
    source: Any = None if value.source_timestamp is None else datetime_from_ticks(value.source_timestamp)
    server: Any = None if value.server_timestamp is None else datetime_from_ticks(value.server_timestamp)
    variant = ua.Variant() if inner is None else to_variant(inner.type, inner.value)
    return ua.DataValue(variant, to_status(value.status), source, server)


NO_TIME: Final = datetime(1601, 1, 1, tzinfo=UTC)
"""A DateTime that is not known: 0 on the wire (OPC 10000-6 5.2.2.5), for which asyncua takes no None."""
_OUT: Final[dict[int, Callable[[Any], Any]]] = {
    BuiltinType.DATETIME: datetime_from_ticks,
    BuiltinType.NODE_ID: node_id,
    BuiltinType.EXPANDED_NODE_ID: _expanded,
    BuiltinType.STATUS_CODE: to_status,
    BuiltinType.QUALIFIED_NAME: lambda value: ua.QualifiedName(value.name, value.namespace),
    BuiltinType.LOCALIZED_TEXT: lambda value: ua.LocalizedText(value.text, value.locale),
    BuiltinType.EXTENSION_OBJECT: _extension_object,
    BuiltinType.DATA_VALUE: _data_value,
    BuiltinType.VARIANT: _nested,
    BuiltinType.XML_ELEMENT: ua.XmlElement,
}
_IN: Final[dict[int, Callable[[Any], Any]]] = {
    BuiltinType.DATETIME: lambda value: ticks_from_datetime(
        value.replace(tzinfo=UTC) if value.tzinfo is None else value
    ),
    BuiltinType.STATUS_CODE: lambda value: int(value.value),
    BuiltinType.QUALIFIED_NAME: lambda value: QualifiedName(value.NamespaceIndex, value.Name),
    BuiltinType.LOCALIZED_TEXT: lambda value: LocalizedText(value.Text, value.Locale),
    BuiltinType.NODE_ID: lambda value: NodeId(value.NamespaceIndex, value.Identifier),
}
_new: Final = object.__new__
_VARIANT_TYPES: Final = {int(kind): ua.VariantType(int(kind)) for kind in BuiltinType}


_PLAIN_TYPES: Final = {
    int(kind): (_VARIANT_TYPES[kind], float if kind in (BuiltinType.FLOAT, BuiltinType.DOUBLE) else int)
    for kind in (
        BuiltinType.SBYTE,
        BuiltinType.BYTE,
        BuiltinType.INT16,
        BuiltinType.UINT16,
        BuiltinType.INT32,
        BuiltinType.UINT32,
        BuiltinType.INT64,
        BuiltinType.UINT64,
        BuiltinType.FLOAT,
        BuiltinType.DOUBLE,
    )
}
"""Of numbers, which are most values, and of which asyncua holds what we hold: the class of the value."""


def to_variant(type_code: int, value: Any) -> ua.Variant:
    """A Variant in asyncua's form; raises Unrepresentable."""
    plain = _PLAIN_TYPES.get(type_code)
    if plain is not None and value.__class__ is plain[1]:
        variant: ua.Variant = _new(ua.Variant)  # what it makes sure of, which takes longer than all else, is so here
        variant.Value, variant.VariantType, variant.Dimensions, variant.is_array = value, plain[0], None, False
        return variant
    kind = type_code & _BUILTIN
    convert = _OUT.get(kind)
    variant_type = _VARIANT_TYPES[kind]
    if kind == BuiltinType.XML_ELEMENT:
        value = tuple(item or "" for item in value) if type(value) is tuple else value or ""
    if not type_code & ARRAY:
        if value is not None:
            return ua.Variant(value if convert is None else convert(value), variant_type, None, False)
        none: Any = NO_TIME if kind == BuiltinType.DATETIME else None
        return ua.Variant(none, variant_type, None, False)
    dimensions: list[Any] | None = None
    if type_code & DIMENSIONS:
        dimensions = list(value.dimensions)
        value = value.values
    if value is not None:
        missing = NO_TIME if kind == BuiltinType.DATETIME else None
        value = list(value) if convert is None else [missing if item is None else convert(item) for item in value]
    return ua.Variant(value, variant_type, dimensions, True)


_NULL: Final = ua.Variant(None, ua.VariantType.Null, None, False)
_NO_ENCODING: Final[Any] = 0
"""asyncua finds it out when it writes the bytes."""


def data_value(type_code: int, value: Any, status: int, source_timestamp: Any, server_timestamp: Any) -> ua.DataValue:
    """A fresh DataValue. What asyncua cannot carry has no value and is Bad_DataEncodingInvalid."""
    if not type_code:
        variant = _NULL
    else:
        try:
            variant = to_variant(type_code, value)
        except (Unrepresentable, ua.UaError, AttributeError, TypeError, ValueError):
            variant, status = _NULL, int(StatusCode.BAD_DATA_ENCODING_INVALID)
    held: ua.DataValue = _new(ua.DataValue)  # as it makes itself of these, in a third of the time
    held.Encoding, held.Value, held.StatusCode = _NO_ENCODING, variant, to_status(status)
    held.SourceTimestamp, held.ServerTimestamp = source_timestamp, server_timestamp
    held.SourcePicoseconds = held.ServerPicoseconds = None
    return held


def fleet_variant(variant: ua.Variant | None) -> tuple[int, Any]:
    """Type code and value of what a client sent; type code 0 for no value."""
    if variant is None or variant.VariantType == ua.VariantType.Null:
        return 0, None
    kind = int(variant.VariantType.value)
    if variant.Dimensions and len(variant.Dimensions) > 1:
        return kind | ARRAY | DIMENSIONS, variant.Value
    if variant.is_array:
        return kind | ARRAY, None if variant.Value is None else tuple(fleet_value(kind, item) for item in variant.Value)
    return kind, fleet_value(kind, variant.Value)


def fleet_value(kind: int, value: Any) -> Any:
    """A scalar of asyncua as ours."""
    convert = _IN.get(kind)
    return value if convert is None or value is None else convert(value)
