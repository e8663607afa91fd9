"""The part of a series that a calculation needs: the rows of a stretch of time, and those around it."""

from __future__ import annotations

from typing import Final, NamedTuple

from ua_fleet.history.bounds import Points, Settings
from ua_fleet.history.rows import BAD_NO_DATA, EARLIEST, LATEST, Row, Series
from ua_fleet.values import Quality

__all__ = ["MOST_ROWS", "Extent", "Window", "extent_of", "window"]

MOST_ROWS: Final = 200_000
"""Of one calculation: 40 MB, for a moment."""
SEARCHED: Final = 1_000
"""Rows in which a usable one is looked for beyond the stretch (OPC 10000-13 3.1.8 leaves it to the server)."""


class Extent(NamedTuple):
    """From when to when a series has values."""

    first: int
    last: int


class Window(NamedTuple):
    """Rows, and whether the stretch has more than may be read at once."""

    points: Points
    is_cut: bool
    reaches: int
    """Up to which time all rows of the stretch are there."""


def extent_of(series: Series) -> Extent | None:
    """The times of the first and the last value; None where there is none. A mark that none was there yet is none."""
    first = [row for row in series.between(EARLIEST, LATEST, 2) if not is_mark(row)]
    last = series.between(EARLIEST, LATEST, 1, backward=True)
    return Extent(first[0].time, last[0].time) if first and last else None


def window(series: Series, low: int, high: int, settings: Settings, most: int = MOST_ROWS) -> Window:
    """The rows from `low` to `high`, with the nearest usable ones around them and all in between."""
    before = _around(series, EARLIEST, low - 1, settings, backward=True)[::-1]
    within = series.between(low, high, most + 1)
    is_cut = len(within) > most
    reaches = within[most].time - 1 if is_cut else high
    after = [] if is_cut else _around(series, high + 1, LATEST, settings, backward=False)
    return Window(Points([*before, *within[:most], *after], settings), is_cut, reaches)


def is_mark(row: Row) -> bool:
    """Whether a row says no more than that there is no value."""
    return row.status & 0xFFFF_0000 == BAD_NO_DATA


def _around(series: Series, first: int, last: int, settings: Settings, *, backward: bool) -> list[Row]:
    """The rows up to the nearest usable one, and with sloped extrapolation one more."""
    if first > last:
        return []
    wanted = 2 if settings.sloped_extrapolation else 1
    most = wanted
    while True:
        found = series.between(first, last, most, backward=backward)
        usable = 0
        for index, row in enumerate(found):
            usable += settings.quality(row) is not Quality.BAD
            if usable == wanted:
                return found[: index + 1]
        if len(found) < most or most >= SEARCHED:
            return found
        most = SEARCHED
