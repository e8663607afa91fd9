"""Operations of requests in one pass, where they have the plain form that nearly all have.

A decoder here never says what is wrong with bytes, and builds nothing of what it does not know to its end: for whatever
is not plain (a range, a filter, an array, a structure, bytes that are missing) it gives None, and the operation is
scanned and built by asyncua. What it charges is what the scan charges.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.binary.builtin import NUMBERS
from ua_fleet.endpoint.scan import step_of

__all__ = ["PLAIN", "decode_plain"]

_Plain = Callable[[bytes, int], tuple[Any, int, int]]
"""A value, where it ends, and the memory that it is charged beyond what its type is."""

_FOUR: Final = struct.Struct("<xBH")
_SEVEN: Final = struct.Struct("<xHI")
_NAMED: Final = struct.Struct("<xHi")
_LENGTH: Final = struct.Struct("<i")
_NUMBER: Final = struct.Struct("<I")
_TIME: Final = struct.Struct("<q")
_AFTER_NODE_ID: Final = struct.Struct("<I4sh4s")
"""AttributeId, and no IndexRange and DataEncoding."""
_PARAMETERS: Final = struct.Struct("<iId3sIB")
"""MonitoringMode, ClientHandle, SamplingInterval, no filter, QueueSize, DiscardOldest."""
_VALUE_HEAD: Final = struct.Struct("<I4sB")
"""AttributeId, no IndexRange, and the mask of the DataValue."""
_DIRECTION: Final = struct.Struct("<i")
_WISHES: Final = struct.Struct("<?II")
"""IncludeSubtypes, NodeClassMask, ResultMask."""
_NULL: Final = b"\xff\xff\xff\xff"
_NO_OBJECT: Final = b"\x00\x00\x00"
_MOST_ARGUMENTS: Final = 64
_WITH_VALUE, _WITH_CODE, _WITH_SOURCE, _WITH_SERVER = 1, 2, 4, 8
"""Bits of a DataValue's mask; those of picoseconds are not plain."""
_TWO_BYTE: Final = ua.NodeIdType.TwoByte
_FOUR_BYTE: Final = ua.NodeIdType.FourByte
_NUMERIC: Final = ua.NodeIdType.Numeric
_STRING: Final = ua.NodeIdType.String
_VARIANT_STRING: Final = int(ua.VariantType.String)
_SCALARS: Final = {
    int(kind): (kind, struct.Struct(f"<{NUMBERS[kind.name]}"), step_of(getattr(ua, kind.name)).memory)
    for kind in ua.VariantType
    if kind.name in NUMBERS
}
_TEXT_MEMORY: Final = step_of(ua.String).memory
_VARIANT_MEMORY: Final = step_of(ua.Variant).memory


class _NotPlainError(Exception):
    """The operation has another form."""


def decode_plain(kind: Any, data: bytes, position: int) -> tuple[Any, int, int] | None:
    """An operation of a class that has a decoder here; None where it has not the plain form.

    Returns the operation, where it ends, and the memory that it is charged beyond what its class is.
    """
    try:
        value, end, memory = PLAIN[kind](data, position)
    except (_NotPlainError, struct.error, IndexError, ValueError):
        return None
    return (value, end, memory) if end <= len(data) else None


def _node_id(data: bytes, position: int) -> tuple[Any, int]:
    kind = data[position]
    node_id: Any = object.__new__(ua.NodeId)
    if kind == 1:
        node_id.NamespaceIndex, node_id.Identifier = _FOUR.unpack_from(data, position)
        node_id.NodeIdType, end = _FOUR_BYTE, position + 4
    elif kind == 3:
        namespace, length = _NAMED.unpack_from(data, position)
        start = position + _NAMED.size
        end = start + length
        if length < 0 or end > len(data):
            raise _NotPlainError
        node_id.NamespaceIndex, node_id.Identifier = namespace, data[start:end].decode()
        node_id.NodeIdType = _STRING
    elif kind == 2:
        node_id.NamespaceIndex, node_id.Identifier = _SEVEN.unpack_from(data, position)
        node_id.NodeIdType, end = _NUMERIC, position + 7
    elif kind == 0:
        node_id.NamespaceIndex, node_id.Identifier = 0, data[position + 1]
        node_id.NodeIdType, end = _TWO_BYTE, position + 2
    else:
        raise _NotPlainError
    return node_id, end


def _variant(data: bytes, position: int) -> tuple[Any, int, int]:
    """A number or a text; no array."""
    kind = data[position]
    if kind == _VARIANT_STRING:
        (length,) = _LENGTH.unpack_from(data, position + 1)
        start = position + 5
        end = start + length
        if length < 0 or end > len(data):
            raise _NotPlainError
        return _scalar(data[start:end].decode(), ua.VariantType.String), end, _TEXT_MEMORY
    found = _SCALARS.get(kind)
    if found is None:
        raise _NotPlainError
    variant_type, unpacked, memory = found
    (value,) = unpacked.unpack_from(data, position + 1)
    return _scalar(value, variant_type), position + 1 + unpacked.size, memory


def _scalar(value: Any, variant_type: ua.VariantType) -> Any:
    variant: Any = object.__new__(ua.Variant)
    variant.Value, variant.VariantType, variant.Dimensions, variant.is_array = value, variant_type, None, False
    return variant


def _read_value_id(data: bytes, position: int) -> tuple[Any, int, int]:
    node_id, at = _node_id(data, position)
    attribute, index_range, namespace, name = _AFTER_NODE_ID.unpack_from(data, at)
    if index_range != _NULL or name != _NULL:
        raise _NotPlainError
    encoding = ua.QualifiedName(None, namespace)
    return ua.ReadValueId(node_id, attribute, None, encoding), at + _AFTER_NODE_ID.size, 0


def _write_value(data: bytes, position: int) -> tuple[Any, int, int]:
    node_id, at = _node_id(data, position)
    attribute, index_range, mask = _VALUE_HEAD.unpack_from(data, at)
    if index_range != _NULL or mask & ~(_WITH_CODE | _WITH_SOURCE | _WITH_SERVER) != _WITH_VALUE:
        raise _NotPlainError
    variant, at, memory = _variant(data, at + _VALUE_HEAD.size)
    parts: dict[str, Any] = {}
    if mask & _WITH_CODE:
        parts["StatusCode"] = ua.StatusCode(_NUMBER.unpack_from(data, at)[0])
        at += _NUMBER.size
    for bit, name in ((_WITH_SOURCE, "SourceTimestamp"), (_WITH_SERVER, "ServerTimestamp")):
        if mask & bit:
            parts[name] = ua.win_epoch_to_datetime(_TIME.unpack_from(data, at)[0])
            at += _TIME.size
    return ua.WriteValue(node_id, attribute, None, ua.DataValue(variant, **parts)), at, memory


def _call_method_request(data: bytes, position: int) -> tuple[Any, int, int]:
    object_id, at = _node_id(data, position)
    method_id, at = _node_id(data, at)
    (count,) = _LENGTH.unpack_from(data, at)
    if not 0 <= count <= _MOST_ARGUMENTS:
        raise _NotPlainError
    at += _LENGTH.size
    arguments: list[Any] = []
    memory = count * _VARIANT_MEMORY
    for _ in range(count):
        variant, at, taken = _variant(data, at)
        memory += taken
        arguments.append(variant)
    return ua.CallMethodRequest(object_id, method_id, arguments), at, memory


def _monitored_item_create_request(data: bytes, position: int) -> tuple[Any, int, int]:
    target, at, _ = _read_value_id(data, position)
    mode, handle, interval, no_filter, queue_size, discards = _PARAMETERS.unpack_from(data, at)
    if no_filter != _NO_OBJECT:
        raise _NotPlainError
    parameters = ua.MonitoringParameters(handle, interval, ua.ExtensionObject(), queue_size, discards != 0)
    wanted = ua.MonitoredItemCreateRequest(target, ua.MonitoringMode(mode), parameters)
    return wanted, at + _PARAMETERS.size, 0


def _browse_description(data: bytes, position: int) -> tuple[Any, int, int]:
    node_id, at = _node_id(data, position)
    (direction,) = _DIRECTION.unpack_from(data, at)
    type_id, at = _node_id(data, at + _DIRECTION.size)
    subtypes, node_classes, wishes = _WISHES.unpack_from(data, at)
    wanted = ua.BrowseDescription(node_id, ua.BrowseDirection(direction), type_id, subtypes, node_classes, wishes)
    return wanted, at + _WISHES.size, 0


PLAIN: Final[dict[Any, _Plain]] = {
    ua.ReadValueId: _read_value_id,
    ua.WriteValue: _write_value,
    ua.CallMethodRequest: _call_method_request,
    ua.MonitoredItemCreateRequest: _monitored_item_create_request,
    ua.BrowseDescription: _browse_description,
}
"""Decoders by the class of what they build."""
