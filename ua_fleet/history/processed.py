"""Aggregates over intervals: ReadProcessed (OPC 10000-11 6.5.4, intervals in OPC 10000-13 5.4.2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from ua_fleet.history.aggregates import NEEDS_NUMBERS, Aggregate, Interval, calculate, has_numbers
from ua_fleet.history.bounds import Settings
from ua_fleet.history.rows import TICKS_PER_MS, Row, Series
from ua_fleet.history.window import extent_of, window

__all__ = ["Failure", "ProcessedPage", "ProcessedRead", "read_processed"]


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

    Args:
        series: of the node.
        read: a request whose start is not its end.
        first: number of the first interval.
        most: intervals of a page of this server.
    """
    count = min(most, read.count - first)
    intervals = [read.interval(number) for number in range(first, first + count)]
    if not intervals:
        return ProcessedPage([], None)
    # The page is cut at its late end where it has too many rows; with time running backward that is its beginning.
    while True:
        low, high = min(one.low for one in intervals), max(one.high for one in intervals)
        found = window(series, low, high, read.settings)
        if not found.is_cut:
            break
        fitting = len(intervals) // 2
        if not fitting:
            return Failure(is_too_much=True)
        intervals = intervals[:fitting]
    if read.aggregate in NEEDS_NUMBERS and not has_numbers(found.points, low, high):
        return Failure(is_too_much=False)
    extent = extent_of(series)
    rows = [calculate(read.aggregate, found.points, one, extent) for one in intervals]
    following = first + len(intervals)
    return ProcessedPage(rows, following if following < read.count else None)
