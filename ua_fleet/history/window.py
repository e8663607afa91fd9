"""The part of a series that a calculation needs: the rows of a stretch of time, and those around it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from ua_fleet.history.bounds import Points, Settings
from ua_fleet.history.rows import BAD_NO_DATA, EARLIEST, LATEST, Row, Series
from ua_fleet.values import Quality
from ua_fleet.wire.builtin import FIXED

__all__ = ["MOST_CUTS", "MOST_ROWS", "SEARCHED", "Extent", "Piece", "extent_of", "piece", "window", "without_value"]

MOST_ROWS: Final = 200_000
"""Of one interval, and of a page but for its last piece: 40 MB, for a moment."""
MOST_CUTS: Final = 8
"""How often the bytes of values are too many to be read at once, in one piece and in one page: after 512 MB others of
the store have their turn."""
SEARCHED: Final = 1_000
"""Rows in which a usable one is looked for beyond the stretch (OPC 10000-13 3.1.8 leaves it to the server)."""


class Extent(NamedTuple):
    """From when to when a series has values."""

    first: int
    last: int


class Piece(NamedTuple):
    """Some of the rows of a stretch, from its beginning on."""

    rows: list[Row]
    """In the order of their times."""
    reaches: int | None
    """Up to which time all of them are here, or from which on where the stretch is gone through backward; None where
    they are all of the stretch."""
    is_large: bool
    """Whether their bytes are why there are no more."""
    cuts: int
    """How often their bytes were too many to be read at once."""


def extent_of(series: Series) -> Extent | None:
    """The times of the first and the last value; None where there is none. A mark that none was there yet is none."""
    first = [row for row in series.between(EARLIEST, LATEST, 2) if not is_mark(row)]
    last = series.between(EARLIEST, LATEST, 1, backward=True)
    return Extent(first[0].time, last[0].time) if first and last else None


def piece(series: Series, low: int, high: int, most: int, *, backward: bool, with_values: bool) -> Piece:
    """At most so many rows of the stretch from `low` to `high`, the latest ones where it is gone through backward.

    Without values those of a fixed size come with it all the same, and what is read is `MOST_CUTS` times as much.
    """
    found: list[Row] = []
    cuts = 0
    while True:
        part = series.between(low, high, most + 1 - len(found), backward=backward)
        found += part if with_values else map(without_value, part)
        is_large = part.is_cut and len(found) <= most
        cuts += part.is_cut
        if with_values or not is_large or cuts >= MOST_CUTS:
            break
        del part  # its values, before the next ones come
        low, high = (low, found[-1].time - 1) if backward else (found[-1].time + 1, high)
    reaches: int | None = None
    if is_large:
        reaches = found[-1].time
    elif len(found) > most:
        reaches = found.pop().time + (1 if backward else -1)
    return Piece(found[::-1] if backward else found, reaches, is_large, cuts)


def without_value(row: Row) -> Row:
    """A row without its value, but for one of a fixed size."""
    return row if row.type in FIXED else row._replace(value=None)


def window(
    series: Series, rows: Sequence[Row], low: int, high: int, settings: Settings, *, of_numbers: bool = False
) -> Points:
    """The rows from `low` to `high`, with the nearest usable ones around them and all in between.

    Of numbers, one that is none (NaN) is not usable.
    """
    before = _around(series, EARLIEST, low - 1, settings, backward=True, of_numbers=of_numbers)[::-1]
    after = _around(series, high + 1, LATEST, settings, backward=False, of_numbers=of_numbers)
    return Points([*before, *rows, *after], settings)


def is_mark(row: Row) -> bool:
    """Whether a row says no more than that there is no value."""
    return row.status & 0xFFFF_0000 == BAD_NO_DATA


def _around(
    series: Series, first: int, last: int, settings: Settings, *, backward: bool, of_numbers: bool
) -> list[Row]:
    """The rows up to the nearest usable one, and with sloped extrapolation one more."""
    if first > last:
        return []
    wanted = 2 if settings.sloped_extrapolation else 1
    most = wanted
    while True:
        found = series.between(first, last, most, backward=backward)
        usable = 0
        for index, row in enumerate(found):
            if of_numbers and row.value != row.value:
                continue
            usable += settings.quality(row) is not Quality.BAD
            if usable == wanted:
                return found[: index + 1]
        if len(found) < most or most >= SEARCHED:
            return found
        most = SEARCHED
