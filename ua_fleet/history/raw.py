"""Values as they were recorded: ReadRaw (OPC 10000-11 6.5.3, bounding values in 4.6).

Of a request with bounds the values are: the last one at or before its start, those in between, the first one at or
after its end; without them those from its start on, its end excluded. Time runs backward where the end is before the
start, or where the end alone is given. Where no value is there for a bound, one with Bad_BoundNotFound stands for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

from ua_fleet.history.rows import BAD_BOUND_NOT_FOUND, EARLIEST, LATEST, Row, Rows, Series

__all__ = ["Phase", "Position", "RawPage", "RawRead", "read_raw"]


_PAGE_BYTES: Final = 16_000_000
"""What the values of a page take in memory: an answer has room for half of it."""


class Phase(IntEnum):
    """What of a request comes next."""

    BEGIN = 0
    WITHIN = 1
    END_BOUND = 2


class Position(NamedTuple):
    """Where a request goes on."""

    phase: Phase
    time: int
    """Within: of the next value."""


@dataclass(frozen=True, slots=True)
class RawRead:
    """A request."""

    start: int | None
    """Ticks; None: not given."""
    end: int | None
    most: int
    """Values of a page; 0: as many as there are."""
    bounds: bool

    @property
    def is_valid(self) -> bool:
        """Whether two of start, end and number are given."""
        return (self.start is not None) + (self.end is not None) + (self.most > 0) >= 2

    @property
    def backward(self) -> bool:
        """Whether the latest value comes first."""
        return self.start is None or (self.end is not None and self.end < self.start)

    @property
    def begin(self) -> int:
        """The time of the first value."""
        begin = self.end if self.start is None else self.start
        assert begin is not None
        return begin

    @property
    def stop(self) -> int | None:
        """The time of the last one."""
        return None if self.start is None else self.end


class RawPage(NamedTuple):
    """A part of the answer."""

    rows: list[Row | None]
    """None: a bound that is not there, of an end that is not given either."""
    rest: Position | None
    """Where the next part begins."""


def read_raw(series: Series, read: RawRead, at: Position | None, most: int) -> RawPage:
    """A page of a request.

    Args:
        series: of the node.
        read: a valid request.
        at: where to go on; None: at its beginning.
        most: values of a page of this server.
    """
    room = min(most, read.most) if read.most else most
    rows: list[Row | None] = []
    phase, time = (Phase.BEGIN, read.begin) if at is None else at
    if phase is Phase.BEGIN:
        if read.bounds:
            rows.append(_nearest(series, read.begin, backward=not read.backward) or _missing(read.begin))
            time = read.begin + (-1 if read.backward else 1)
        phase = Phase.WITHIN
    if phase is Phase.WITHIN:
        within = _within(series, read, time, room - len(rows) + 1)
        if len(rows) + len(within) > room:
            rest = within[room - len(rows)]
            return RawPage([*rows, *within[: room - len(rows)]], Position(Phase.WITHIN, rest.time))
        rows += within
        if within.is_cut:  # for its bytes, with no row to tell what comes next
            return RawPage(rows, Position(Phase.WITHIN, within[-1].time + (-1 if read.backward else 1)))
    if not read.bounds:
        return RawPage(rows, None)
    if len(rows) >= room:
        return RawPage(rows, Position(Phase.END_BOUND, 0))
    return RawPage([*rows, _end_bound(series, read)], None)


def _within(series: Series, read: RawRead, time: int, most: int) -> Rows:
    """The values from a time on to the end, which is excluded but where it is the start."""
    stop, backward = read.stop, read.backward
    if stop is None:
        last = EARLIEST if backward else LATEST
    elif stop == read.begin:
        last = stop
    else:
        last = stop + 1 if backward else stop - 1
    first, last = (last, time) if backward else (time, last)
    if first > last:
        return Rows(0)
    return series.between(first, last, most, backward=backward, most_bytes=_PAGE_BYTES)


def _end_bound(series: Series, read: RawRead) -> Row | None:
    stop = read.stop
    if stop is None:
        return None
    at = stop if stop != read.begin else stop + (-1 if read.backward else 1)
    return _nearest(series, at, backward=read.backward) or _missing(stop)


def _nearest(series: Series, time: int, *, backward: bool) -> Row | None:
    """The first value at a time or after it; or, backward, before it."""
    first, last = (EARLIEST, time) if backward else (time, LATEST)
    found = series.between(first, last, 1, backward=backward)
    return found[0] if found else None


def _missing(time: int) -> Row:
    return Row(time, BAD_BOUND_NOT_FOUND, 0, None)
