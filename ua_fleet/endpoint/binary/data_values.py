"""Bytes of DataValues (OPC 10000-6 5.2.2.17), kept beside the value that they are of.

A DataValue is never changed: whatever writes to a node brings a fresh one. So bytes are good for as long as the same
object is there, and nothing has to be told when it goes.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import struct
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.binary.builtin import encode_time, encode_variant

__all__ = ["MOST_KEPT", "encode_data_value", "kept_bytes", "with_times"]

MOST_KEPT: Final = 512
"""Bytes of a value that are kept; encoding a longer one takes little of the time that it takes to send it."""

_CODE: Final = struct.Struct("<I")
_PICOSECONDS: Final = struct.Struct("<H")
_SOURCE, _SERVER, _SOURCE_PICOSECONDS, _SERVER_PICOSECONDS = 4, 8, 16, 32
"""Bits of the first byte."""
_TIME: Final = 8
_FINER: Final = 2
_PLAIN: Final = b"\x0f"
"""Value, StatusCode and both times."""


def encode_data_value(value: Any) -> bytes:
    """A DataValue, its times in the order of the standard; raises what asyncua raises."""
    variant, code, source, server = value.Value, value.StatusCode, value.SourceTimestamp, value.ServerTimestamp
    source_ps, server_ps = value.SourcePicoseconds, value.ServerPicoseconds
    if source_ps is None is server_ps and None not in (variant, code, source, server):
        sent = encode_time(source)
        received = sent if server is source else encode_time(server)
        return _PLAIN + encode_variant(variant) + _CODE.pack(code.value) + sent + received
    mask = 0
    parts = [b""]
    for bit, part, encode in (
        (1, variant, encode_variant),
        (2, None if code is None else code.value, _CODE.pack),
        (_SOURCE, source, encode_time),
        (_SOURCE_PICOSECONDS, source_ps, _PICOSECONDS.pack),
        (_SERVER, server, encode_time),
        (_SERVER_PICOSECONDS, server_ps, _PICOSECONDS.pack),
    ):
        if part is not None:
            mask |= bit
            parts.append(encode(part))
    parts[0] = bytes((mask,))
    return b"".join(parts)


def with_times(data: bytes, wanted: ua.TimestampsToReturn) -> bytes:
    """The bytes of a DataValue with the times that a client asks for, out of those with all that it has."""
    if wanted == ua.TimestampsToReturn.Both:
        return data
    mask = data[0]
    source = (_TIME if mask & _SOURCE else 0) + (_FINER if mask & _SOURCE_PICOSECONDS else 0)
    server = (_TIME if mask & _SERVER else 0) + (_FINER if mask & _SERVER_PICOSECONDS else 0)
    end = len(data) - server
    if wanted == ua.TimestampsToReturn.Source:
        return bytes((mask & ~(_SERVER | _SERVER_PICOSECONDS),)) + data[1:end]
    mask &= ~(_SOURCE | _SOURCE_PICOSECONDS)
    if wanted == ua.TimestampsToReturn.Server:
        return bytes((mask,)) + data[1 : end - source] + data[end:]
    return bytes((mask & ~(_SERVER | _SERVER_PICOSECONDS),)) + data[1 : end - source]


def kept_bytes(held: Any, value: Any) -> bytes | None:
    """The bytes of a small value that `held` holds now, or held a moment ago; None for a large one.

    Raises what asyncua raises for what cannot be encoded.
    """
    kept = held.encoded
    if kept is not None and kept[0] is value:
        data: bytes = kept[1]
        return data
    content = value.Value.Value if value.Value is not None else None
    if isinstance(content, list | tuple | str | bytes) and len(content) > MOST_KEPT:
        return None
    data = encode_data_value(value)
    if len(data) > MOST_KEPT:
        return None
    if held.value is value:
        held.encoded = value, data
    return data
