"""Aggregates over intervals: ReadProcessed (OPC 10000-11 6.5.4, intervals in OPC 10000-13 5.4.2.2)."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from operator import itemgetter
from typing import Final, NamedTuple

from ua_fleet.history.aggregates import NEEDS_NO_VALUES, NEEDS_NUMBERS, Aggregate, Interval, calculate, has_numbers
from ua_fleet.history.bounds import Settings
from ua_fleet.history.rows import MOST_READ_BYTES, TICKS_PER_MS, Row, Series, value_bytes
from ua_fleet.history.window import MOST_CUTS, MOST_ROWS, extent_of, piece, window

__all__ = ["Failure", "ProcessedPage", "ProcessedRead", "read_processed"]

PIECE_ROWS: Final = 20_000
"""Rows that are read at once: they are made in 5 ms."""


@dataclass(frozen=True, slots=True)
class ProcessedRead:
    """A request for one node."""

    start: int
    end: int
    interval_ms: float
    """0: one interval for all."""
    aggregate: Aggregate
    settings: Settings

    @property
    def step(self) -> int:
        """The length of an interval in ticks."""
        whole = abs(self.end - self.start)
        step = int(self.interval_ms * TICKS_PER_MS) if self.interval_ms < whole else whole
        return whole if step <= 0 or step > whole else step

    @property
    def count(self) -> int:
        """Number of the intervals."""
        return -(-abs(self.end - self.start) // self.step)

    def interval(self, number: int) -> Interval:
        """One of them, from 0 on."""
        step, whole = self.step, abs(self.end - self.start)
        near, far = number * step, min((number + 1) * step, whole)
        is_short = far - near < step
        if self.end < self.start:
            return Interval(self.start - far, self.start - near, True, is_short)
        return Interval(self.start + near, self.start + far, False, is_short)


class Failure(NamedTuple):
    """Why nothing is calculated."""

    is_too_much: bool
    """An interval has more values than are read at once; otherwise the values are no numbers."""


class ProcessedPage(NamedTuple):
    """A part of the answer."""

    rows: list[Row]
    rest: int | None
    """Number of the interval with which the next part begins."""


def read_processed(series: Series, read: ProcessedRead, first: int, most: int) -> ProcessedPage | Failure:
    """A page of a request.

    It is calculated piece by piece: a day of rows takes long to make and to free, and others of this process would wait
    for it. A page ends early where values are large, by what was read for it and by what it holds.

    Args:
        series: of the node.
        read: a request whose start is not its end.
        first: number of the first interval.
        most: intervals of a page of this server.
    """
    backward, with_values = read.end < read.start, read.aggregate not in NEEDS_NO_VALUES
    intervals = [read.interval(number) for number in range(first, min(first + most, read.count))]
    extent = extent_of(series)
    rows: list[Row] = []
    looked, cuts, held, room = 0, 0, 0, PIECE_ROWS
    while len(rows) < len(intervals) and looked < MOST_ROWS and cuts < MOST_CUTS and held < MOST_READ_BYTES:
        rest = intervals[len(rows) :]
        found = piece(series, *_stretch(rest), room, backward=backward, with_values=with_values)
        cuts += found.cuts
        if found.reaches is not None:
            rest = _whole(rest, found.reaches, backward=backward)
        if not rest:
            if not found.is_large and room < MOST_ROWS and cuts < MOST_CUTS:
                room = min(4 * room, MOST_ROWS)
                continue
            if rows:
                break
            return Failure(is_too_much=True)
        low, high = _stretch(rest)
        within = found.rows[bisect_left(found.rows, low, key=_TIME) : bisect_right(found.rows, high, key=_TIME)]
        if read.aggregate in NEEDS_NUMBERS and not has_numbers(within):
            return Failure(is_too_much=False)
        # The bounds of a TimeAverage are values, too, also where none is within.
        by_bounds = read.aggregate is Aggregate.TIME_AVERAGE
        points = window(series, within, low, high, read.settings, of_numbers=by_bounds)
        if by_bounds and not has_numbers(points.rows):
            return Failure(is_too_much=False)
        made = [calculate(read.aggregate, points, one, extent) for one in rest]
        rows += made
        held += sum(value_bytes(row.value) for row in made)
        looked += len(points.rows)
    following = first + len(rows)
    return ProcessedPage(rows, following if following < read.count else None)


def _whole(intervals: Sequence[Interval], reaches: int, *, backward: bool) -> list[Interval]:
    """The intervals whose rows are all there."""
    if backward:
        return list(takewhile(lambda one: one.low >= reaches, intervals))
    return list(takewhile(lambda one: one.high <= reaches, intervals))


def _stretch(intervals: Sequence[Interval]) -> tuple[int, int]:
    """The earliest and the latest time of intervals that follow each other, whichever way time runs."""
    return min(intervals[0].low, intervals[-1].low), max(intervals[0].high, intervals[-1].high)


_TIME: Final = itemgetter(Row._fields.index("time"))
