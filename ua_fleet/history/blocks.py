"""Rows as bytes: one by one, many in a block, and as HistoryData for clients.

A block is compressed, and holds columns: times as differences, StatusCodes, and values, which are one array where all
have the same type of a fixed size. 1,000 Doubles at equal times take 9 bytes each.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import accumulate, pairwise
from typing import Any, Final

from ua_fleet.errors import LocalWireError
from ua_fleet.history.rows import BAD_BOUND_NOT_FOUND, Row
from ua_fleet.values import StatusCode
from ua_fleet.wire.builtin import FIXED
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.variant import decode_typed, encode_typed

__all__ = [
    "HISTORY_DATA",
    "decode_block",
    "decode_value",
    "encode_block",
    "encode_rows",
    "encode_value",
    "has_fixed_size",
]

HISTORY_DATA: Final = 658
"""NodeId of the binary encoding of HistoryData."""
_LEVEL: Final = 6
_HEAD: Final = struct.Struct("<BIq")
_make_row: Callable[[tuple[Any, ...]], Row] = partial(tuple.__new__, Row)  # pyright: ignore[reportUnknownMemberType]
"""A Row of its fields, in a third of the time that `Row._make` takes: a day of seconds is 86,400 of them."""
_NO_VALUES: Final = 0
_SAME_TYPE: Final = 1
_ANY: Final = 2


def encode_value(row: Row) -> bytes:
    """The value of a row as a Variant; empty for none, and for one that cannot be encoded."""
    if not row.type:
        return b""
    out = bytearray()
    try:
        encode_typed(out, row.type, row.value)
    except LocalWireError:
        return b""
    return bytes(out)


def decode_value(time: int, status: int, data: bytes) -> Row:
    """A row of such a value; raises RemoteWireError."""
    if not data:
        return Row(time, status, 0, None)
    return Row(time, status, data[0], decode_typed(Cursor(data, 1), data[0]))


def encode_block(rows: Sequence[Row]) -> bytes:
    """Rows in the order of their times."""
    count = len(rows)
    times = [row.time for row in rows]
    steps = [later - earlier for earlier, later in pairwise(times)]
    kinds = {row.type for row in rows}
    kind = kinds.pop() if len(kinds) == 1 else -1
    layout = FIXED.get(kind)
    values: bytes
    if layout is not None:
        form = _SAME_TYPE
        values = bytes([kind]) + struct.pack(f"<{count}{layout.format[1:]}", *[row.value for row in rows])
    elif kind == 0:
        form, values = _NO_VALUES, b""
    else:
        form = _ANY
        parts = [encode_value(row) for row in rows]
        values = b"".join([len(part).to_bytes(4, "little") + part for part in parts])
    data = b"".join(
        (
            struct.pack(f"<{count - 1}q", *steps),
            struct.pack(f"<{count}I", *[row.status for row in rows]),
            values,
        )
    )
    return _HEAD.pack(form, count, times[0]) + zlib.compress(data, _LEVEL)


def decode_block(data: bytes) -> list[Row]:
    """The rows of a block; raises RemoteWireError, zlib.error or struct.error for one that is broken."""
    head: tuple[int, int, int] = _HEAD.unpack_from(data)
    form, count, time = head
    body = zlib.decompress(data[_HEAD.size :])
    steps = struct.unpack_from(f"<{count - 1}q", body)
    statuses = struct.unpack_from(f"<{count}I", body, 8 * (count - 1))
    at = 8 * (count - 1) + 4 * count
    times = list(accumulate(steps, initial=time))
    if form == _NO_VALUES:
        return list(map(_make_row, zip(times, statuses, [0] * count, [None] * count, strict=True)))
    if form == _SAME_TYPE:
        kind = int(body[at])
        values = struct.unpack_from(f"<{count}{FIXED[kind].format[1:]}", body, at + 1)
        return list(map(_make_row, zip(times, statuses, [kind] * count, values, strict=True)))
    rows: list[Row] = []
    for moment, status in zip(times, statuses, strict=True):
        length = int.from_bytes(body[at : at + 4], "little")
        rows.append(decode_value(moment, status, body[at + 4 : at + 4 + length]))
        at += 4 + length
    return rows


def has_fixed_size(data: bytes) -> bool:
    """Whether the values of a block have a fixed size, or are none."""
    return data[0] != _ANY


_PLAIN: Final = {kind: struct.Struct(f"<BB{layout.format[1:]}q") for kind, layout in FIXED.items()}
_WITH_STATUS: Final = {kind: struct.Struct(f"<BB{layout.format[1:]}Iq") for kind, layout in FIXED.items()}
_NO_VALUE: Final = struct.Struct("<BIq")
_TIME: Final = struct.Struct("<q")
_STATUS_AND_TIME: Final = struct.Struct("<Iq")


def encode_rows(rows: Iterable[Row | None], room: int, whole: int) -> tuple[bytes, int]:
    """HistoryData (OPC 10000-11 6.6.2) of as many rows as fit into so many bytes, and their number.

    Args:
        rows: None for a bound that is not there. They are taken one by one, up to the first one that does not fit.
        room: bytes that are left in this answer.
        whole: bytes that an answer has at most. A value that no answer has room for is told by its time and
            Bad_EncodingLimitsExceeded, so that those behind it can be read.
    """
    parts: list[bytes] = []
    left = room - 4
    for row in rows:
        data = _encode_row(row)
        if row is not None and len(data) > whole - 4:
            data = _NO_VALUE.pack(0x06, _TOO_LARGE, row.time)
        left -= len(data)
        if left < 0:
            break
        parts.append(data)
    return len(parts).to_bytes(4, "little") + b"".join(parts), len(parts)


def _encode_row(row: Row | None) -> bytes:
    """A DataValue (OPC 10000-6 5.2.2.17) with its SourceTimestamp."""
    if row is None:
        return _BOUND_WITHOUT_TIME
    time, status, kind, value = row.time, row.status, row.type, row.value
    try:
        if not status and (layout := _PLAIN.get(kind)) is not None:
            return layout.pack(0x05, kind, value, time)
        if (layout := _WITH_STATUS.get(kind)) is not None:
            return layout.pack(0x07, kind, value, status, time)
    except (struct.error, OverflowError):  # the latter for what is no Float on a line that goes on
        return _NO_VALUE.pack(0x06, _BAD_ENCODING, time)
    if not kind:
        return _NO_VALUE.pack(0x06, status, time)
    data = encode_value(row)
    if not data:
        return _NO_VALUE.pack(0x06, _BAD_ENCODING, time)
    return b"\x07" + data + _STATUS_AND_TIME.pack(status, time)


_BAD_ENCODING: Final = int(StatusCode.BAD_ENCODING_ERROR)
_TOO_LARGE: Final = int(StatusCode.BAD_ENCODING_LIMITS_EXCEEDED)
_BOUND_WITHOUT_TIME: Final = b"\x02" + BAD_BOUND_NOT_FOUND.to_bytes(4, "little")
