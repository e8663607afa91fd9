"""Values at given times: ReadAtTime (OPC 10000-11 6.5.5)."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from typing import Final

from ua_fleet.history.bounds import Points, Settings, interpolated_bound, simple_bound
from ua_fleet.history.rows import EARLIEST, LATEST, MOST_READ_BYTES, Row, Series
from ua_fleet.history.window import MOST_CUTS, SEARCHED, without_value

__all__ = ["TooMuch", "read_at_times"]

_GROWTH: Final = 9
"""How many times as many rows are read next as were read in vain."""


class TooMuch(Exception):
    """So many bytes of values would be read for the times of one request that others wait for too long."""


def read_at_times(series: Series, times: Iterable[int], settings: Settings, *, simple: bool) -> Iterator[Row]:
    """A value for each of the times, in their order: the one that was recorded then, or an interpolated one.

    Each is looked for when it is taken, so that no more of them are in memory than an answer has room for. Raises
    TooMuch: large values that are not usable are looked through for each, and those that no answer has room for are
    read all the same.

    Args:
        series: of the node.
        times: ticks.
        settings: how values count.
        simple: with simple bounding values in place of interpolated ones.
    """
    bound = simple_bound if simple else interpolated_bound
    surroundings = _Surroundings(series, settings)
    for time in times:
        yield bound(surroundings.of(time), time).row


class _Surroundings:
    """The rows around one time after the other. What was read for one of them is there for the next one: where no value
    is usable, each time has `SEARCHED` rows on each side that are looked through in vain.
    """

    def __init__(self, series: Series, settings: Settings) -> None:
        self._series, self._settings = series, settings
        self._wanted = 2 if settings.sloped_extrapolation else 1
        """Usable rows on each side."""
        self._low, self._high = 0, -1
        """All rows of the series from here to there are known."""
        self._rows: list[Row] = []
        self._times: list[int] = []
        self._usable: list[int] = []
        """The times of those that are usable."""
        self._left = 2 * MOST_CUTS * MOST_READ_BYTES
        """Bytes of values that may yet be read, for all times together."""

    def of(self, time: int) -> Points:
        """The nearest usable rows around a time, and the rows that are next to it, as far as they are found."""
        if not self._low <= time <= self._high + 1:
            self._low, self._high = time, time - 1
            self._rows, self._times, self._usable = [], [], []
        self._search(time, backward=True)
        self._search(time, backward=False)
        self._forget_but(time)
        # Of what is in between, only that it is there says something, and the rows next to the time say that.
        at = bisect_left(self._times, time)
        chosen = {at - 1, at, *(bisect_left(self._times, each) for each in self._usable)}
        return Points([self._rows[each] for each in sorted(chosen) if 0 <= each < len(self._rows)], self._settings)

    def _search(self, time: int, *, backward: bool) -> None:
        """Know as many usable rows on one side of a time as are wanted; a row of this very time is behind it."""
        while True:
            before, usable = bisect_left(self._times, time), bisect_left(self._usable, time)
            known = before if backward else len(self._times) - before
            found = usable if backward else len(self._usable) - usable
            is_end = self._low <= EARLIEST if backward else self._high >= LATEST
            if found >= self._wanted or known >= SEARCHED or is_end:
                return
            most = min(max(self._wanted, _GROWTH * known), SEARCHED - known)
            if self._read_on(most, backward=backward):
                return  # a time has as many bytes as are read at once

    def _read_on(self, most: int, *, backward: bool) -> bool:
        """Know at most so many rows more on one side; whether it is for their bytes that they are fewer."""
        if self._left <= 0:
            raise TooMuch
        first, last = (EARLIEST, self._low - 1) if backward else (self._high + 1, LATEST)
        found = self._series.between(first, last, most, backward=backward)
        self._left -= MOST_READ_BYTES - found.room_bytes
        is_end = len(found) < most and not found.is_cut
        indices = self._settings.usable(found)
        usable = [found[each].time for each in indices]
        values = set(indices)
        rows = [row if at in values or row.value is None else without_value(row) for at, row in enumerate(found)]
        times = [row.time for row in rows]
        if backward:
            self._low = EARLIEST if is_end else times[-1]
            self._rows, self._times = rows[::-1] + self._rows, times[::-1] + self._times
            self._usable = usable[::-1] + self._usable
        else:
            self._high = LATEST if is_end else times[-1]
            self._rows += rows
            self._times += times
            self._usable += usable
        return found.is_cut

    def _forget_but(self, time: int) -> None:
        """Keep what is wanted around a time, and what may be looked through for it."""
        at, usable = bisect_left(self._times, time), bisect_left(self._usable, time)
        first, end = max(at - SEARCHED, 0), min(at + SEARCHED, len(self._times))
        if usable >= self._wanted:
            first = max(first, bisect_left(self._times, self._usable[usable - self._wanted]))
        if len(self._usable) - usable >= self._wanted:
            end = min(end, bisect_left(self._times, self._usable[usable + self._wanted - 1]) + 1)
        if first > 0:
            self._low = self._times[first]
        if end < len(self._times):
            self._high = self._times[end - 1]
        self._rows, self._times = self._rows[first:end], self._times[first:end]
        within = bisect_left(self._usable, self._low), bisect_left(self._usable, self._high + 1)
        self._usable = self._usable[slice(*within)]
