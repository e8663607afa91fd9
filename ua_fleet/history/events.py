"""Events of the past: as bytes, as rows of a series, and read in pages (OPC 10000-11 6.5.2).

An event is a row like a value: its fields are encoded once, when it happens, and clients get these bytes. There are two
series, since AuditEvents are for engineers alone. A row's time is the event's Time, or as much later as the rows of the
series have to have different times. It is never later than the server's clock: one bridge whose clock is fast would
move the events of all others. Where the server's clock was set back, events stand behind those that are there.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Final, NamedTuple

from ua_fleet.history.raw import RawRead
from ua_fleet.history.recorder import Kept
from ua_fleet.history.rows import BAD_DATA_LOST, EARLIEST, LATEST, MOST_READ_BYTES, Row, Rows, Series
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType, NodeId, datetime_from_ticks

__all__ = [
    "AUDIT_EVENTS",
    "EVENTS",
    "BrokenEvent",
    "EventPage",
    "EventPosition",
    "EventRecorder",
    "KeptEvent",
    "MergedSeries",
    "encode_event",
    "first_position",
    "read_events",
]

EVENTS: Final = NodeId(0, 2253)
"""The series of all events but AuditEvents, named after the Server object."""
AUDIT_EVENTS: Final = NodeId(0, 2052)
"""The series of AuditEvents, named after their type."""
MOST_LATER: Final = TICKS_PER_SECOND
"""How much later or earlier than the event's Time a row may stand, and yet be found by that Time."""
_CHUNK: Final = 200
"""Rows that are read from the store at once."""
_HEAD: Final = struct.Struct("<BqHH")
_FORM: Final = 1


def encode_event(time: int, fields: Mapping[str, bytes]) -> bytes:
    """An event as the value of a row.

    Args:
        time: its field Time, in ticks.
        fields: each as an encoded Variant, by its BrowsePath (`EnabledState/Id`).
    """
    names = "\0".join(fields).encode()
    lengths = struct.pack(f"<{len(fields)}I", *map(len, fields.values()))
    return b"".join((_HEAD.pack(_FORM, time, len(fields), len(names)), names, lengths, *fields.values()))


class KeptEvent:
    """Such an event; of its fields those are looked at that are asked for."""

    __slots__ = ("_at", "_data", "_lengths", "_places", "time")

    def __init__(self, data: bytes) -> None:
        """Take what `encode_event` has made; raises struct.error or ValueError for anything else."""
        form, self.time, count, size = _HEAD.unpack_from(data)
        if form != _FORM:
            raise ValueError(f"an event of form {form}")
        begin = _HEAD.size + size
        self._places = _places_of(data[_HEAD.size : begin])
        self._lengths: tuple[int, ...] = struct.unpack_from(f"<{count}I", data, begin)
        self._at, self._data = begin + 4 * count, data
        if self._at + sum(self._lengths) != len(data):  # clients get the bytes of fields as they are
            raise ValueError(f"an event of {len(data)} bytes with fields up to {self._at + sum(self._lengths)}")

    @property
    def names(self) -> Iterable[str]:
        """The BrowsePaths of its fields."""
        return self._places.keys()

    def field(self, name: str) -> bytes | None:
        """A field as an encoded Variant; None where the event has none of this name."""
        place = self._places.get(name)
        if place is None:
            return None
        start = self._at + sum(self._lengths[:place])
        return self._data[start : start + self._lengths[place]]


@lru_cache(512)
def _places_of(names: bytes) -> dict[str, int]:
    """Where each field is, by the names of all."""
    return {name: place for place, name in enumerate(names.decode().split("\0"))}


class EventRecorder:
    """Makes rows of events. Times are ticks of the wall clock."""

    def __init__(self, before: Mapping[NodeId, int] | None = None, stopped_at: int = 0) -> None:
        """Go on with what is stored.

        Args:
            before: the time of the last row of each series that has any.
            stopped_at: when the last process that recorded was last alive. What happened after that is not known, and
                marked so before the first event that follows.
        """
        self._last = dict(before or {})
        self._stopped_at = stopped_at
        self._gap = EVENTS in self._last

    def take(self, time: int, data: bytes, wall: int, *, is_audit: bool = False) -> list[Kept]:
        """The rows of an event of such a Time."""
        key = AUDIT_EVENTS if is_audit else EVENTS
        last = self._last.get(key, -1)
        at = max(min(time, wall), last + 1)
        kept: list[Kept] = []
        if key == EVENTS and self._gap:
            self._gap = False
            marked = max(last + 1, min(self._stopped_at, at - 1))
            kept, at = [(key, Row(marked, BAD_DATA_LOST, 0, None))], max(at, marked + 1)
        self._last[key] = at
        return [*kept, (key, Row(at, 0, int(BuiltinType.BYTE_STRING), data))]

    def put_behind(self, stored: Mapping[NodeId, int], stopped_at: int, waiting: Mapping[NodeId, int]) -> None:
        """Go on behind what a store has that was not known so far; as `Recorder.put_behind`.

        What waits has the mark of the gap already; where nothing does, the next event has it.
        """
        self._stopped_at = stopped_at
        self._gap = EVENTS in stored and EVENTS not in waiting
        for key in (EVENTS, AUDIT_EVENTS):
            last = max(times.get(key, -1) for times in (self._last, stored, waiting))
            if last >= 0:
                self._last[key] = last


class MergedSeries:
    """The rows of several series as those of one. Rows of different ones may have the same time."""

    def __init__(self, parts: Sequence[Series]) -> None:
        self._parts = parts

    def between(
        self, first: int, last: int, most: int, *, backward: bool = False, most_bytes: int = MOST_READ_BYTES
    ) -> Rows:
        """As `Series.between`; of rows with the same time in the order of the series."""
        parts = [part.between(first, last, most, backward=backward, most_bytes=most_bytes) for part in self._parts]
        # Of what is further than the end of one that is cut, nobody knows what comes before it.
        ends = [part[-1].time for part in parts if part.is_cut]
        low, high = (max(ends, default=first), last) if backward else (first, min(ends, default=last))
        together = [row for part in parts for row in part if low <= row.time <= high]
        together.sort(key=lambda row: row.time, reverse=backward)
        found = Rows(most)
        found.take_numbers(together)  # their bytes are bounded by now
        found.is_cut = bool(ends)
        return found


class EventPosition(NamedTuple):
    """Where a request goes on."""

    time: int
    """Of the next row."""
    skipped: int = 0
    """Rows of this very time that come before it."""


class BrokenEvent(Exception):
    """A row that holds no event, or one with a field that cannot be read. It costs nobody another event."""


class EventPage(NamedTuple):
    """A part of the answer."""

    events: list[bytes]
    """What `chosen` made of each."""
    rest: EventPosition | None
    """Where the next part begins."""
    looked: int
    """Rows that were looked at."""
    broken: Sequence[str] = ()
    """Why some of them were left out, in one line each."""


def read_events(
    series: Series,
    read: RawRead,
    at: EventPosition | None,
    chosen: Callable[[Row], bytes | None],
    *,
    most: int,
    room: int,
    most_rows: int,
) -> EventPage:
    """A page of a request.

    Args:
        series: of events.
        read: a valid request, without bounds.
        at: where to go on; None: at its beginning.
        chosen: what the client gets of an event; None for one that it does not want. Raises BrokenEvent.
        most: events of a page of this server.
        room: bytes that the events may take.
        most_rows: how many are looked at: a page of a filter that few events pass may be empty, and have a rest.
    """
    most = min(most, read.most) if read.most else most
    low, high = _extent(read)
    events: list[bytes] = []
    broken: list[str] = []
    looked = 0
    for row, position in _rows(series, low, high, at, backward=read.backward):
        if looked == most_rows:
            return EventPage(events, position, looked, broken)
        looked += 1
        try:
            event = chosen(row) if low <= _found_at(row) <= high else None
        except BrokenEvent as error:
            time = datetime_from_ticks(row.time)
            broken.append(f"the event of the history at {time} is broken ({error}), and left out")
            continue
        if event is None:
            continue
        room -= len(event)
        if len(events) == most or room < 0:
            return EventPage(events, position, looked, broken)
        events.append(event)
    return EventPage(events, None, looked, broken)


def first_position(read: RawRead) -> EventPosition:
    """Where a request begins."""
    first, last = _span(*_extent(read))
    return EventPosition(last if read.backward else first)


def _extent(read: RawRead) -> tuple[int, int]:
    """The first and the last time of a request; its end is excluded, but where it is the start."""
    begin, stop = read.begin, read.stop
    if stop is None:
        return (EARLIEST, begin) if read.backward else (begin, LATEST)
    if stop == begin:
        return begin, begin
    return (stop + 1, begin) if read.backward else (begin, stop - 1)


def _span(low: int, high: int) -> tuple[int, int]:
    """The first and the last time of rows that may belong to such times."""
    return max(low - MOST_LATER, EARLIEST), min(high + MOST_LATER, LATEST)


def _found_at(row: Row) -> int:
    """The time by which an event is found: its Time, where the row stands there but for a moment.

    Raises:
        BrokenEvent: the row is broken.
    """
    if row.value is None:
        return row.time
    try:
        time: int = _HEAD.unpack_from(row.value)[1]
    except (struct.error, TypeError) as error:
        raise BrokenEvent(str(error)) from error
    return time if abs(row.time - time) <= MOST_LATER else row.time


def _rows(
    series: Series, low: int, high: int, at: EventPosition | None, *, backward: bool
) -> Iterator[tuple[Row, EventPosition]]:
    """The rows that may belong to such times, each with its position."""
    first, last = _span(low, high)
    skipped = 0
    if at is not None:
        first, last = (first, at.time) if backward else (at.time, last)
        skipped = at.skipped
    same, before = 0, -1
    while first <= last:
        found = series.between(first, last, _CHUNK, backward=backward)
        for number, row in enumerate(found):
            same, before = (same + 1 if row.time == before else 0), row.time
            if number >= skipped:
                yield row, EventPosition(row.time, same)
        if len(found) < _CHUNK and not found.is_cut:
            return
        skipped = 1 + sum(1 for later, earlier in pairwise(reversed(found)) if later.time == earlier.time == before)
        first, last = (first, before) if backward else (before, last)
        same, before = 0, -1
