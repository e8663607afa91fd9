"""Values at times at which none was recorded: bounding values (OPC 10000-13 3.1.7 to 3.1.9).

Interpolated ones look past Bad values for the nearest usable ones, and are Uncertain where they did. Simple ones look
at the nearest values alone, and are Bad where the one before is. A line is drawn between numbers of a type; all else,
and what is stepped, keeps the value before.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from operator import itemgetter
from typing import Final, NamedTuple

from ua_fleet.history.rows import BAD, BAD_NO_DATA, UNCERTAIN_DATA_SUB_NORMAL, HistoryBits, Row, is_number, with_bits
from ua_fleet.values import BuiltinType, Quality, quality_of

__all__ = ["Bound", "Points", "Settings", "interpolated_bound", "no_data", "simple_bound"]


@dataclass(frozen=True, slots=True)
class Settings:
    """How values are calculated (OPC 10000-13 4.2.1.2); what stands here are the defaults of the standard."""

    stepped: bool = False
    treat_uncertain_as_bad: bool = True
    percent_data_bad: int = 100
    percent_data_good: int = 100
    sloped_extrapolation: bool = False

    @property
    def is_valid(self) -> bool:
        """Whether the percentages make sense together: each at most 100, and no interval both Good and Bad."""
        return (
            0 <= self.percent_data_bad <= 100
            and 0 <= self.percent_data_good <= 100
            and self.percent_data_good >= 100 - self.percent_data_bad
        )

    def quality(self, row: Row) -> Quality:
        """What a value counts as."""
        quality = quality_of(row.status)
        if quality is Quality.UNCERTAIN and self.treat_uncertain_as_bad:
            return Quality.BAD
        return quality

    def usable(self, rows: Sequence[Row]) -> Sequence[int]:
        """Where the values are that do not count as Bad."""
        statuses = list(map(_STATUS, rows))
        if not any(statuses):  # as nearly always
            return range(len(rows))
        limit = _UNCERTAIN if self.treat_uncertain_as_bad else BAD
        return [index for index, status in enumerate(statuses) if status < limit]


_UNCERTAIN: Final = 0x4000_0000
"""StatusCodes below this are Good, and those below `BAD` Good or Uncertain."""
_TIME: Final = itemgetter(Row._fields.index("time"))
_STATUS: Final = itemgetter(Row._fields.index("status"))


class Points:
    """Rows in the order of their times, with the settings by which they count."""

    def __init__(self, rows: Sequence[Row], settings: Settings) -> None:
        self.rows = rows
        self.settings = settings
        self.times: list[int] = list(map(_TIME, rows))

    def within(self, low: int, high: int) -> Sequence[Row]:
        """The rows from `low` on, `high` excluded."""
        return self.rows[bisect_left(self.times, low) : bisect_left(self.times, high)]

    def at(self, time: int) -> Row | None:
        """The row of exactly this time."""
        index = bisect_left(self.times, time)
        return self.rows[index] if index < len(self.rows) and self.times[index] == time else None

    @cached_property
    def _usable(self) -> Sequence[int]:
        """Indices of the rows that are not Bad.

        They are found once: a page has thousands of intervals, and two usable rows may be a hundred thousand apart.
        """
        return self.settings.usable(self.rows)

    @cached_property
    def numbers(self) -> Points:
        """The same, but that a Good or Uncertain value that is no number (NaN) is none, and Bad."""
        rows = [row if row.value == row.value else Row(row.time, BAD, 0, None) for row in self.rows]
        return Points(rows, self.settings)

    def usable_before(self, time: int) -> tuple[int, Row] | None:
        """The last row before a time that is not Bad, and its index."""
        at = bisect_left(self._usable, bisect_left(self.times, time)) - 1
        if at < 0:
            return None
        index = self._usable[at]
        return index, self.rows[index]

    def usable_after(self, time: int) -> tuple[int, Row] | None:
        """The first one after it."""
        at = bisect_left(self._usable, bisect_right(self.times, time))
        if at == len(self._usable):
            return None
        index = self._usable[at]
        return index, self.rows[index]


class Bound(NamedTuple):
    """A value at a time, and what it was made of."""

    row: Row
    quality: Quality
    """As it counts: Bad has no value."""


def no_data(time: int) -> Row:
    """That nothing is known of a time."""
    return Row(time, BAD_NO_DATA, 0, None)


def interpolated_bound(points: Points, time: int, *, stepped: bool | None = None) -> Bound:
    """By the nearest usable values (3.1.8)."""
    settings = points.settings
    exact = points.at(time)
    if exact is not None and settings.quality(exact) is not Quality.BAD:
        return Bound(exact, quality_of(exact.status))
    found = points.usable_before(time)
    if found is None:
        return Bound(no_data(time), Quality.BAD)
    index, before = found
    after = points.usable_after(time)
    is_stepped = settings.stepped if stepped is None else stepped
    value, is_between = _between(points, before, None if after is None else after[1], time, stepped=is_stepped)
    if after is None or not is_between:
        # Between the value before and this time; behind the last one all is uncertain.
        skipped = bisect_right(points.times, time) - index > 1
        is_uncertain = after is None or skipped
    else:
        is_uncertain = after[0] - index > 1 or quality_of(after[1].status) is Quality.UNCERTAIN
    is_uncertain = is_uncertain or quality_of(before.status) is Quality.UNCERTAIN
    return _estimate(time, before.type, value, uncertain=is_uncertain)


def simple_bound(points: Points, time: int) -> Bound:
    """By the nearest values, whatever they are (3.1.9)."""
    settings = points.settings
    exact = points.at(time)
    if exact is not None:
        usable = settings.quality(exact) is not Quality.BAD
        return Bound(exact, quality_of(exact.status)) if usable else Bound(no_data(time), Quality.BAD)
    index = bisect_left(points.times, time) - 1
    if index < 0 or index + 1 >= len(points.rows) or settings.quality(points.rows[index]) is Quality.BAD:
        return Bound(no_data(time), Quality.BAD)
    before, after = points.rows[index], points.rows[index + 1]
    is_uncertain = quality_of(before.status) is Quality.UNCERTAIN
    is_after_bad = settings.quality(after) is Quality.BAD
    is_stepped = settings.stepped or is_after_bad
    value, is_between = _between(points, before, after, time, stepped=is_stepped)
    if not settings.stepped and (is_between or is_after_bad):
        is_uncertain = is_uncertain or quality_of(after.status) is not Quality.GOOD
    return _estimate(time, before.type, value, uncertain=is_uncertain)


def _between(points: Points, row: Row, after: Row | None, time: int, *, stepped: bool) -> tuple[object, bool]:
    """The value on the line through two rows, and whether there is one; else the value of the first."""
    if stepped or not is_number(row.type):
        return row.value, False
    if after is None:
        if not points.settings.sloped_extrapolation:
            return row.value, False
        earlier = points.usable_before(row.time)
        if earlier is None or earlier[1].type != row.type:
            return row.value, False
        return _on_line(earlier[1], row, time), False
    if after.type != row.type:
        return row.value, False
    return _on_line(row, after, time), True


def _on_line(first: Row, second: Row, time: int) -> float | int:
    rise, part, whole = second.value - first.value, time - first.time, second.time - first.time
    if first.type in (BuiltinType.FLOAT, BuiltinType.DOUBLE):
        return float(first.value + rise * (part / whole))
    value: int = round(first.value + Fraction(rise * part, whole))  # no Double holds all of Int64
    return value


def _estimate(time: int, kind: int, value: object, *, uncertain: bool) -> Bound:
    status = UNCERTAIN_DATA_SUB_NORMAL if uncertain else 0
    quality = Quality.UNCERTAIN if uncertain else Quality.GOOD
    return Bound(Row(time, with_bits(status, HistoryBits.INTERPOLATED), kind, value), quality)
