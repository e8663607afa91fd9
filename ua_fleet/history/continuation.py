"""Continuation points that say themselves where a read goes on: the server keeps nothing for them.

    version, kind | the request and where it goes on | code

The code (HMAC-SHA-256, cut to 16 bytes) is made with a secret of the store and the node's id. So a point that somebody
made up, or that belongs to another node, is refused; one that a client kept goes on after a new connection, and after a
restart of the server.
"""

from __future__ import annotations

import hashlib
import hmac
import struct
from typing import Any, Final

from ua_fleet.history.aggregates import Aggregate
from ua_fleet.history.bounds import Settings
from ua_fleet.history.events import EventPosition
from ua_fleet.history.processed import ProcessedRead
from ua_fleet.history.raw import Phase, Position, RawRead

__all__ = ["Continuations"]

_RAW: Final = b"\x01r"
_PROCESSED: Final = b"\x01p"
_EVENTS: Final = b"\x01e"
_RAW_BODY: Final = struct.Struct("<qqI?Bq")
_PROCESSED_BODY: Final = struct.Struct("<qqdHBBBBI")
_EVENTS_BODY: Final = struct.Struct("<qqI16sqB")
_CODE_BYTES: Final = 16
_NOT_GIVEN: Final = -1


class Continuations:
    """Makes and reads them."""

    def __init__(self, secret: bytes) -> None:
        """Use a secret that nobody else knows."""
        self._secret = secret

    def of_raw(self, node: str, read: RawRead, at: Position) -> bytes:
        """A point of a ReadRaw."""
        start = _NOT_GIVEN if read.start is None else read.start
        end = _NOT_GIVEN if read.end is None else read.end
        return self._signed(node, _RAW + _RAW_BODY.pack(start, end, read.most, read.bounds, at.phase, at.time))

    def of_processed(self, node: str, read: ProcessedRead, number: int) -> bytes:
        """A point of a ReadProcessed."""
        settings = read.settings
        flags = settings.treat_uncertain_as_bad | settings.sloped_extrapolation << 1
        body = _PROCESSED_BODY.pack(
            read.start,
            read.end,
            read.interval_ms,
            read.aggregate,
            settings.percent_data_bad,
            settings.percent_data_good,
            flags,
            settings.stepped,
            number,
        )
        return self._signed(node, _PROCESSED + body)

    def of_events(self, node: str, read: RawRead, filter_data: bytes, at: EventPosition) -> bytes:
        """A point of a ReadEvents with this encoded EventFilter. It has no room for that: the client sends it again."""
        start = _NOT_GIVEN if read.start is None else read.start
        end = _NOT_GIVEN if read.end is None else read.end
        body = _EVENTS_BODY.pack(start, end, read.most, _digest(filter_data), at.time, at.skipped)
        return self._signed(node, _EVENTS + body)

    def read_raw(self, node: str, point: bytes) -> tuple[RawRead, Position] | None:
        """What a point of a ReadRaw says; None for one that is none of ours."""
        body = self._verified(node, point, _RAW, _RAW_BODY)
        if body is None:
            return None
        start, end, most, bounds, phase, time = body
        read = RawRead(None if start == _NOT_GIVEN else start, None if end == _NOT_GIVEN else end, most, bool(bounds))
        return read, Position(Phase(phase), time)

    def read_processed(self, node: str, point: bytes) -> tuple[ProcessedRead, int] | None:
        """The same of a ReadProcessed."""
        body = self._verified(node, point, _PROCESSED, _PROCESSED_BODY)
        if body is None:
            return None
        start, end, interval_ms, aggregate, bad, good, flags, stepped, number = body
        settings = Settings(bool(stepped), bool(flags & 1), bad, good, bool(flags & 2))
        return ProcessedRead(start, end, interval_ms, Aggregate(aggregate), settings), number

    def read_events(self, node: str, filter_data: bytes, point: bytes) -> tuple[RawRead, EventPosition] | None:
        """The same of a ReadEvents; None also for a point of another EventFilter."""
        body = self._verified(node, point, _EVENTS, _EVENTS_BODY)
        if body is None:
            return None
        start, end, most, digest, time, skipped = body
        if digest != _digest(filter_data):
            return None
        read = RawRead(None if start == _NOT_GIVEN else start, None if end == _NOT_GIVEN else end, most, bounds=False)
        return read, EventPosition(time, skipped)

    def _signed(self, node: str, body: bytes) -> bytes:
        return body + self._code(node, body)

    def _code(self, node: str, body: bytes) -> bytes:
        return hmac.new(self._secret, node.encode() + b"\0" + body, hashlib.sha256).digest()[:_CODE_BYTES]

    def _verified(self, node: str, point: bytes, kind: bytes, layout: struct.Struct) -> tuple[Any, ...] | None:
        body, code = point[:-_CODE_BYTES], point[-_CODE_BYTES:]
        if len(body) != len(kind) + layout.size or not body.startswith(kind):
            return None
        if not hmac.compare_digest(code, self._code(node, body)):
            return None
        return layout.unpack(body[len(kind) :])


def _digest(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()[:16]
