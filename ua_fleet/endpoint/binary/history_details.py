"""What a HistoryRead wants of all its nodes (OPC 10000-11 6.5), in one pass where it is one of three forms.

As in `decoders`: nothing is refused here, and what is charged is what the scan charges.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.binary.decoders import NotPlainError, decode_node_id, in_one_pass
from ua_fleet.endpoint.convert import exact_datetime
from ua_fleet.endpoint.scan import step_of
from ua_fleet.endpoint.stack import ObjectIds

__all__ = ["decode_history_details"]

_HEAD: Final = struct.Struct("<BBHBi")
"""NodeId of the details' encoding in four bytes, that there is a body, and its length."""
_RAW: Final = struct.Struct("<?qqI?")
_COUNT: Final = struct.Struct("<i")
_BETWEEN: Final = struct.Struct("<qqdi")
"""StartTime, EndTime, ProcessingInterval, number of AggregateTypes."""
_CONFIGURATION: Final = struct.Struct("<??BB?")
_FLAG: Final = struct.Struct("<?")
_MOST: Final = 1_000
"""Times, or aggregates."""
_TIME_MEMORY: Final = step_of(ua.DateTime).memory
_NODE_ID_MEMORY: Final = step_of(ua.NodeId).memory

_Body = Callable[[bytes, int], tuple[Any, int, int]]


def decode_history_details(data: bytes, position: int) -> tuple[Any, int, int] | None:
    """HistoryReadDetails, where they end, and what they are charged beyond an ExtensionObject; None for other forms."""
    return in_one_pass(_details, data, position)


def _details(data: bytes, position: int) -> tuple[Any, int, int]:
    form, namespace, kind, has_body, length = _HEAD.unpack_from(data, position)
    known = _FORMS.get(kind)
    if (form, namespace, has_body) != (1, 0, 1) or known is None:
        raise NotPlainError
    decode, own_memory = known
    start = position + _HEAD.size
    details, end, memory = decode(data, start)
    if end != start + length:
        raise NotPlainError
    return details, end, own_memory + memory


def _raw(data: bytes, at: int) -> tuple[Any, int, int]:
    modified, begin, end, count, bounds = _RAW.unpack_from(data, at)
    times = exact_datetime(begin), exact_datetime(end)
    return ua.ReadRawModifiedDetails(modified, *times, count, bounds), at + _RAW.size, 0


def _at_times(data: bytes, at: int) -> tuple[Any, int, int]:
    (count,) = _COUNT.unpack_from(data, at)
    if not 0 <= count <= _MOST:
        raise NotPlainError
    at += _COUNT.size
    times: list[Any] = [exact_datetime(time) for time in struct.unpack_from(f"<{count}q", data, at)]
    at += 8 * count
    (simple,) = _FLAG.unpack_from(data, at)
    return ua.ReadAtTimeDetails(times, simple), at + _FLAG.size, count * _TIME_MEMORY


def _processed(data: bytes, at: int) -> tuple[Any, int, int]:
    begin, end, interval, count = _BETWEEN.unpack_from(data, at)
    if not 0 <= count <= _MOST:
        raise NotPlainError
    at += _BETWEEN.size
    kinds: list[Any] = []
    for _ in range(count):
        kind, at = decode_node_id(data, at)
        kinds.append(kind)
    configuration: Any = ua.AggregateConfiguration(*_CONFIGURATION.unpack_from(data, at))
    times = exact_datetime(begin), exact_datetime(end)
    details = ua.ReadProcessedDetails(*times, interval, kinds, configuration)
    return details, at + _CONFIGURATION.size, count * _NODE_ID_MEMORY


_FORMS: Final[dict[int, tuple[_Body, int]]] = {
    int(getattr(ObjectIds, f"{kind.__name__}_Encoding_DefaultBinary")): (decode, step_of(kind).memory)
    for kind, decode in (
        (ua.ReadRawModifiedDetails, _raw),
        (ua.ReadAtTimeDetails, _at_times),
        (ua.ReadProcessedDetails, _processed),
    )
}
"""Decoder of a body, and what its structure takes, by the identifier of its encoding."""
