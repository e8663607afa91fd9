"""Operations of requests in one pass, where they have the plain form that nearly all have; see `history_details`, too.

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
from ua_fleet.endpoint.binary.encoders import NO_OBJECT
from ua_fleet.endpoint.scan import step_of
from ua_fleet.endpoint.stack import GOOD, ObjectIds

__all__ = [
    "PLAIN",
    "NotPlainError",
    "decode_node_id",
    "decode_plain",
    "decode_plain_arguments",
    "decode_plain_value",
    "in_one_pass",
]

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
_ITEM_HEAD: Final = struct.Struct("<iId")
"""MonitoringMode, ClientHandle, SamplingInterval."""
_ITEM_REST: Final = struct.Struct("<IB")
"""QueueSize, DiscardOldest."""
_OBJECT_HEAD: Final = struct.Struct("<BBHBi")
"""NodeId of a structure's encoding in four bytes, that there is a body, and its length."""
_DATA_FILTER: Final = struct.Struct("<BBHBiiId")
"""The same, with Trigger, DeadbandType and DeadbandValue."""
_DATA_FILTER_HEAD: Final = (1, 0, int(ObjectIds.DataChangeFilter_Encoding_DefaultBinary), 1, 16)
_VALUE_HEAD: Final = struct.Struct("<I4s")
"""AttributeId, and no IndexRange."""
_TWO_NUMBERS: Final = struct.Struct("<II")
_HISTORY_NODE: Final = struct.Struct("<4sh4si")
"""No IndexRange and DataEncoding, and the length of the ContinuationPoint."""
_MOST_POINT: Final = 1_024
_DIRECTION: Final = struct.Struct("<i")
_WISHES: Final = struct.Struct("<?II")
"""IncludeSubtypes, NodeClassMask, ResultMask."""
_NULL: Final = b"\xff\xff\xff\xff"
_MOST_ARGUMENTS: Final = 64
_WITH_VALUE, _WITH_CODE, _WITH_SOURCE, _WITH_SERVER = 1, 2, 4, 8
"""Bits of a DataValue's mask; those of picoseconds are not plain."""
_WITH_ANY: Final = _WITH_CODE | _WITH_SOURCE | _WITH_SERVER
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
_DATA_FILTER_MEMORY: Final = step_of(ua.DataChangeFilter).memory


class NotPlainError(Exception):
    """The bytes have another form."""


def decode_plain(kind: Any, data: bytes, position: int) -> tuple[Any, int, int] | None:
    """An operation of a class that has a decoder here; None where it has not the plain form.

    Returns the operation, where it ends, and the memory that it is charged beyond what its class is.
    """
    return in_one_pass(PLAIN[kind], data, position)


def decode_plain_value(data: bytes, position: int) -> tuple[Any, int, int] | None:
    """As `decode_plain`, a DataValue: of a number or a text, with no picoseconds."""
    return in_one_pass(_data_value, data, position)


def decode_plain_arguments(data: bytes, position: int) -> tuple[list[Any], int, int] | None:
    """As `decode_plain`, the InputArguments of a Call: numbers and texts."""
    return in_one_pass(_arguments, data, position)


def in_one_pass(decode: _Plain, data: bytes, position: int) -> tuple[Any, int, int] | None:
    """What a decoder says; None where the bytes are not plain, or too few."""
    try:
        value, end, memory = decode(data, position)
    except (NotPlainError, struct.error, IndexError, ValueError):
        return None
    return (value, end, memory) if end <= len(data) else None


def decode_node_id(data: bytes, position: int) -> tuple[Any, int]:
    """A NodeId with a number or a text, and where it ends; raises NotPlainError for any other."""
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
            raise NotPlainError
        node_id.NamespaceIndex, node_id.Identifier = namespace, data[start:end].decode()
        node_id.NodeIdType = _STRING
    elif kind == 2:
        node_id.NamespaceIndex, node_id.Identifier = _SEVEN.unpack_from(data, position)
        node_id.NodeIdType, end = _NUMERIC, position + 7
    elif kind == 0:
        node_id.NamespaceIndex, node_id.Identifier = 0, data[position + 1]
        node_id.NodeIdType, end = _TWO_BYTE, position + 2
    else:
        raise NotPlainError
    return node_id, end


def _variant(data: bytes, position: int) -> tuple[Any, int, int]:
    """A number or a text; no array."""
    kind = data[position]
    if kind == _VARIANT_STRING:
        (length,) = _LENGTH.unpack_from(data, position + 1)
        start = position + 5
        end = start + length
        if length < 0 or end > len(data):
            raise NotPlainError
        return _scalar(data[start:end].decode(), ua.VariantType.String), end, _TEXT_MEMORY
    found = _SCALARS.get(kind)
    if found is None:
        raise NotPlainError
    variant_type, unpacked, memory = found
    (value,) = unpacked.unpack_from(data, position + 1)
    return _scalar(value, variant_type), position + 1 + unpacked.size, memory


def _scalar(value: Any, variant_type: ua.VariantType) -> Any:
    variant: Any = object.__new__(ua.Variant)  # what its class makes sure of is so here
    variant.Value, variant.VariantType, variant.Dimensions, variant.is_array = value, variant_type, None, False
    return variant


def _read_value_id(data: bytes, position: int) -> tuple[Any, int, int]:
    node_id, at = decode_node_id(data, position)
    attribute, index_range, namespace, name = _AFTER_NODE_ID.unpack_from(data, at)
    if index_range != _NULL or name != _NULL:
        raise NotPlainError
    encoding = ua.QualifiedName(None, namespace)
    return ua.ReadValueId(node_id, attribute, None, encoding), at + _AFTER_NODE_ID.size, 0


def _data_value(data: bytes, position: int) -> tuple[Any, int, int]:
    """A value with no picoseconds."""
    mask = data[position]
    if mask & ~_WITH_ANY != _WITH_VALUE:
        raise NotPlainError
    value: Any = object.__new__(ua.DataValue)
    value.Encoding, value.StatusCode = 0, GOOD
    value.SourceTimestamp = value.ServerTimestamp = value.SourcePicoseconds = value.ServerPicoseconds = None
    value.Value, at, memory = _variant(data, position + 1)
    if mask & _WITH_CODE:
        value.StatusCode = ua.StatusCode(_NUMBER.unpack_from(data, at)[0])
        at += _NUMBER.size
    if mask & _WITH_SOURCE:
        value.SourceTimestamp = ua.win_epoch_to_datetime(_TIME.unpack_from(data, at)[0])
        at += _TIME.size
    if mask & _WITH_SERVER:
        value.ServerTimestamp = ua.win_epoch_to_datetime(_TIME.unpack_from(data, at)[0])
        at += _TIME.size
    return value, at, memory


def _write_value(data: bytes, position: int) -> tuple[Any, int, int]:
    node_id, at = decode_node_id(data, position)
    attribute, index_range = _VALUE_HEAD.unpack_from(data, at)
    if index_range != _NULL:
        raise NotPlainError
    value, at, memory = _data_value(data, at + _VALUE_HEAD.size)
    return ua.WriteValue(node_id, attribute, None, value), at, memory


def _call_method_request(data: bytes, position: int) -> tuple[Any, int, int]:
    object_id, at = decode_node_id(data, position)
    method_id, at = decode_node_id(data, at)
    arguments, at, memory = _arguments(data, at)
    return ua.CallMethodRequest(object_id, method_id, arguments), at, memory


def _arguments(data: bytes, at: int) -> tuple[list[Any], int, int]:
    (count,) = _LENGTH.unpack_from(data, at)
    if not 0 <= count <= _MOST_ARGUMENTS:
        raise NotPlainError
    at += _LENGTH.size
    arguments: list[Any] = []
    memory = count * _VARIANT_MEMORY
    for _ in range(count):
        variant, at, taken = _variant(data, at)
        memory += taken
        arguments.append(variant)
    return arguments, at, memory


def _monitored_item_create_request(data: bytes, position: int) -> tuple[Any, int, int]:
    target, at, _ = _read_value_id(data, position)
    mode, handle, interval = _ITEM_HEAD.unpack_from(data, at)
    at += _ITEM_HEAD.size
    memory = 0
    wished: Any
    if data.startswith(NO_OBJECT, at):
        wished = ua.ExtensionObject()
        at += len(NO_OBJECT)
    else:
        *head, trigger, deadband_type, deadband = _DATA_FILTER.unpack_from(data, at)
        if tuple(head) != _DATA_FILTER_HEAD:
            raise NotPlainError
        wished = ua.DataChangeFilter(ua.DataChangeTrigger(trigger), deadband_type, deadband)
        at += _DATA_FILTER.size
        memory = _DATA_FILTER_MEMORY
    queue_size, discards = _ITEM_REST.unpack_from(data, at)
    parameters = ua.MonitoringParameters(handle, interval, wished, queue_size, discards != 0)
    wanted = ua.MonitoredItemCreateRequest(target, ua.MonitoringMode(mode), parameters)
    return wanted, at + _ITEM_REST.size, memory


def _acknowledgement(data: bytes, position: int) -> tuple[Any, int, int]:
    subscription_id, sequence = _TWO_NUMBERS.unpack_from(data, position)
    return ua.SubscriptionAcknowledgement(subscription_id, sequence), position + _TWO_NUMBERS.size, 0


def _history_read_value_id(data: bytes, position: int) -> tuple[Any, int, int]:
    node_id, at = decode_node_id(data, position)
    index_range, namespace, name, length = _HISTORY_NODE.unpack_from(data, at)
    at += _HISTORY_NODE.size
    if index_range != _NULL or name != _NULL or not -1 <= length <= _MOST_POINT:
        raise NotPlainError
    point = None if length < 0 else data[at : at + length]
    at += max(length, 0)
    return ua.HistoryReadValueId(node_id, None, ua.QualifiedName(None, namespace), point), at, 0


def _browse_description(data: bytes, position: int) -> tuple[Any, int, int]:
    node_id, at = decode_node_id(data, position)
    (direction,) = _DIRECTION.unpack_from(data, at)
    type_id, at = decode_node_id(data, at + _DIRECTION.size)
    subtypes, node_classes, wishes = _WISHES.unpack_from(data, at)
    wanted = ua.BrowseDescription(node_id, ua.BrowseDirection(direction), type_id, subtypes, node_classes, wishes)
    return wanted, at + _WISHES.size, 0


PLAIN: Final[dict[Any, _Plain]] = {
    ua.ReadValueId: _read_value_id,
    ua.WriteValue: _write_value,
    ua.CallMethodRequest: _call_method_request,
    ua.MonitoredItemCreateRequest: _monitored_item_create_request,
    ua.BrowseDescription: _browse_description,
    ua.SubscriptionAcknowledgement: _acknowledgement,
    ua.HistoryReadValueId: _history_read_value_id,
}
"""Decoders by the class of what they build."""
