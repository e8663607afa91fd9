"""Responses that are encoded while they are built, element by element, within a budget of bytes.

An element that cannot be encoded, or for which there is no room, is told by its own StatusCode; the others are not
touched. So no response grows beyond the budget in memory, however small the request for it was.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import functools
import struct
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

from asyncua import ua

from ua_fleet.endpoint.binary.encoders import encode
from ua_fleet.endpoint.stack import DECODE_ERRORS, StatusCodes, status

__all__ = ["ArrayResponse", "EncodedResponse", "Misfit", "encode_value", "rough_bytes"]

_COUNT: Final = struct.Struct("<I")
_TIME_AND_HANDLE: Final = struct.Struct("<qI")
"""Timestamp and RequestHandle of a ResponseHeader."""
_TYPE_ID_BYTES: Final = 4
"""Of the NodeId that a response begins with: all are in two bytes of the base namespace."""
_HEAD_BYTES: Final = _TYPE_ID_BYTES + 24
"""With a ResponseHeader that has no diagnostics, texts and AdditionalHeader."""
_UNIX_EPOCH_TICKS: Final = 116_444_736_000_000_000
"""1970 in units of 100 ns since 1601 (OPC 10000-6 5.2.2.5)."""
_NO_DIAGNOSTICS: Final = bytes(4)
_ADDITIONAL_INFO: Final = b"\x10"
"""Which fields a DiagnosticInfo has."""
_MOST_REASON: Final = 1000
"""Characters of a reason."""


Misfit = Callable[[str, Exception], None]
"""Told what of this server could not be encoded, and why: a mistake of ours."""


class EncodedResponse:
    """A response whose parameters are bytes already.

    Args:
        kind: asyncua's class of the response.
        parameters: what follows its ResponseHeader.
    """

    __slots__ = ("kind", "parameters")

    def __init__(self, kind: Any, parameters: bytes = b"") -> None:
        self.kind = kind
        self.parameters = parameters

    def encode(self, handle: int) -> bytes:
        """The bytes of the response to the request with this handle, as of now."""
        type_id, rest = _head(self.kind)
        times = _TIME_AND_HANDLE.pack(time.time_ns() // 100 + _UNIX_EPOCH_TICKS, handle)
        return b"".join((type_id, times, rest, *self._parts_of_parameters()))

    def _parts_of_parameters(self) -> Sequence[bytes]:
        return (self.parameters,)


class ArrayResponse(EncodedResponse):
    """A response that ends in an array of results and one of DiagnosticInfos, as most do.

    Args:
        kind: asyncua's class of the response.
        room: bytes that the results may have together.
    """

    __slots__ = ("_parts", "_reasons", "left", "size")

    def __init__(self, kind: Any, room: int) -> None:
        super().__init__(kind)
        self.left = room
        """Bytes that are left for results; 0 after the first one that did not fit."""
        self.size = 0
        """Bytes of the results so far."""
        self._parts: list[bytes] = []
        self._reasons: list[str] = []

    def add(
        self, result: Any, refused: Callable[[int], Any], misfit: Misfit, what: Callable[[], str], *, least: int = 0
    ) -> None:
        """Add a result, or what `refused` makes of Bad_EncodingLimitsExceeded or Bad_EncodingError.

        Args:
            result: asyncua's object.
            refused: makes a result of a StatusCode.
            misfit: told when the result cannot be encoded.
            what: names the result then.
            least: bytes that it takes at least, so that what cannot fit is not encoded.
        """
        if least > self.left:
            self.left = 0
        if self.left:
            try:
                data = encode(result)
            except DECODE_ERRORS as error:
                misfit(what(), error)
                self.add_small(encode(refused(StatusCodes.BadEncodingError)))
                return
            if len(data) <= self.left:
                self.add_bytes(data)
                return
        # All that follow are refused too, so that what does not fit is not encoded ten thousand times.
        self.left = 0
        self.add_small(encode(refused(StatusCodes.BadEncodingLimitsExceeded)))

    def add_bytes(self, data: bytes) -> None:
        """Add a result that is encoded already, and fits."""
        self.left -= len(data)
        self.size += len(data)
        self._parts.append(data)

    def add_small(self, data: bytes) -> None:
        """Add a result of a few bytes, for which there is always room: it says why there is no other."""
        self._parts.append(data)

    def explain(self, reason: str) -> None:
        """Say the reason for the last result in its DiagnosticInfo; empty where there is none. For all, or for none."""
        self._reasons.append(reason)

    def _parts_of_parameters(self) -> Sequence[bytes]:
        return (_COUNT.pack(len(self._parts)), *self._parts, _diagnostics(self._reasons))


@functools.cache
def _head(kind: Any) -> tuple[bytes, bytes]:
    """What stands before and behind Timestamp and RequestHandle in the ResponseHeader of a good response of a class."""
    data = encode(kind())
    return data[:_TYPE_ID_BYTES], data[_TYPE_ID_BYTES + _TIME_AND_HANDLE.size : _HEAD_BYTES]


def _diagnostics(reasons: list[str]) -> bytes:
    """DiagnosticInfos with AdditionalInfo alone (OPC 10000-6 5.2.2.12); none where nobody has a reason."""
    if not any(reasons):
        return _NO_DIAGNOSTICS
    parts = [len(reasons).to_bytes(4, "little")]
    for reason in reasons:
        text = reason[:_MOST_REASON].encode("utf-8", "replace")
        parts.append(_ADDITIONAL_INFO + len(text).to_bytes(4, "little") + text if reason else b"\x00")
    return b"".join(parts)


def rough_bytes(value: ua.DataValue) -> int:
    """The least that a value takes, in memory and when encoded; found without looking at its elements."""
    variant = value.Value
    content: Any = variant.Value if variant is not None else None
    return len(content) if isinstance(content, list | tuple | str | bytes) else 0


def encode_value(value: ua.DataValue, room: int, misfit: Misfit, what: Callable[[], str]) -> bytes:
    """A DataValue as bytes; one that cannot be encoded, or is longer than `room`, as its StatusCode alone."""
    code = StatusCodes.BadEncodingLimitsExceeded
    if rough_bytes(value) <= room:
        try:
            data = encode(value)
            if len(data) <= room:
                return data
        except DECODE_ERRORS as error:
            misfit(what(), error)
            code = StatusCodes.BadEncodingError
    return encode(ua.DataValue(StatusCode=status(code)))
