"""What is calculated of the values of an interval: the aggregates of OPC 10000-13 5.4.3.

Annex A of that document has tables of examples; tests/unit/history holds each function against them. Where text and
tables leave a choice:

* A value with Bad_NoData is a mark that there was none; it counts as no value.
* The last value of a series holds for 1 ms, which is the resolution of durations (the 10,001 ms of table A.29).
* Count is 0 and Good for an interval within the data that has no value.
* A Double or Float that is no number (NaN) counts as Bad for what calculates with values. It is a value for Count and
  DurationGood, and a line from or to it is NaN.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise
from math import isnan, nan
from operator import itemgetter
from typing import Final, NamedTuple

from ua_fleet.history.bounds import Points, interpolated_bound, no_data, simple_bound
from ua_fleet.history.rows import BAD, TICKS_PER_MS, UNCERTAIN_DATA_SUB_NORMAL, HistoryBits, Row, is_number, with_bits
from ua_fleet.history.window import Extent, is_mark
from ua_fleet.values import BuiltinType, Quality, quality_of

__all__ = ["NEEDS_NO_VALUES", "NEEDS_NUMBERS", "Aggregate", "Interval", "calculate", "has_numbers"]


class Aggregate(IntEnum):
    """The functions that there are, by the NodeIds of their Objects in the standard's namespace."""

    INTERPOLATIVE = 2341
    AVERAGE = 2342
    TIME_AVERAGE = 2343
    MINIMUM = 2346
    MAXIMUM = 2347
    COUNT = 2352
    START = 2357
    END = 2358
    DURATION_GOOD = 2360
    PERCENT_GOOD = 2362


NEEDS_NUMBERS: Final = frozenset((Aggregate.AVERAGE, Aggregate.TIME_AVERAGE, Aggregate.MINIMUM, Aggregate.MAXIMUM))
"""Those that calculate with values."""
NEEDS_NO_VALUES: Final = frozenset((Aggregate.COUNT, Aggregate.DURATION_GOOD, Aggregate.PERCENT_GOOD))
"""Those that only ask whether there is one, and of which quality."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A stretch of time: one of its ends is excluded."""

    low: int
    """Its earliest time."""
    high: int
    """Its latest time."""
    backward: bool = False
    """Whether time runs backward: the interval begins with `high`, and `low` is excluded."""
    is_short: bool = False
    """Whether it ends before its ProcessingInterval is over."""

    @property
    def stamp(self) -> int:
        """Its StartTime."""
        return self.high if self.backward else self.low

    def rows(self, points: Points) -> Sequence[Row]:
        """The rows within it."""
        if self.backward:
            return points.within(self.low + 1, self.high + 1)
        return points.within(self.low, self.high)


class _Counted(NamedTuple):
    """The values of an interval by their quality."""

    values: Sequence[Row]
    good: Sequence[Row]
    uncertain: Sequence[Row]
    """Those that do not count as Bad."""
    bad: Sequence[Row]


def calculate(aggregate: Aggregate, points: Points, interval: Interval, extent: Extent | None) -> Row:
    """One aggregate of an interval.

    Args:
        aggregate: the function.
        points: the rows of the interval, and the nearest usable ones around it.
        interval: the stretch of time.
        extent: of the whole series.
    """
    if extent is None:
        return no_data(interval.stamp)
    is_behind = interval.high > extent.last and aggregate in _EXTRAPOLATED
    if not is_behind and not _touches(interval, extent):
        return no_data(interval.stamp)
    row = _FUNCTIONS[aggregate](points, interval, extent)
    if aggregate in NEEDS_NUMBERS and row.value != row.value:
        return _FUNCTIONS[aggregate](points.numbers, interval, extent)
    return row


def _touches(interval: Interval, extent: Extent) -> bool:
    """Whether any of the series lies within an interval."""
    if interval.backward:
        return interval.high >= extent.first and interval.low < extent.last
    return interval.high > extent.first and interval.low <= extent.last


def _partial(interval: Interval, extent: Extent) -> HistoryBits:
    """The bit for an interval that a later read may answer otherwise (5.3.3.2)."""
    is_partial = interval.low < extent.first or interval.high > extent.last or interval.is_short
    return HistoryBits.PARTIAL if is_partial else HistoryBits.RAW


def _count(points: Points, interval: Interval) -> _Counted:
    rows = interval.rows(points)
    if not any(map(_STATUS, rows)):  # as nearly always, and by far the quickest way to see it
        return _Counted(rows, rows, [], [])
    values = [row for row in rows if not is_mark(row)]
    quality = points.settings.quality
    good = [row for row in values if row.status >> 30 == 0]
    if len(good) == len(values):
        return _Counted(values, good, [], [])
    others = [row for row in values if row.status >> 30]
    uncertain = [row for row in others if quality(row) is not Quality.BAD]
    return _Counted(values, good, uncertain, [row for row in others if quality(row) is Quality.BAD])


def _status_by_count(points: Points, counted: _Counted) -> int:
    """The StatusCode of what goes by the number of values (5.4.3.2.1)."""
    settings = points.settings
    if len(counted.good) == len(counted.values):
        return 0
    total = len(counted.values)
    if counted.bad and 100 * len(counted.bad) >= settings.percent_data_bad * total:
        return BAD
    usable = len(counted.good) + len(counted.uncertain)
    if counted.uncertain or 100 * usable < settings.percent_data_good * total:
        return UNCERTAIN_DATA_SUB_NORMAL
    return 0


def _interpolative(points: Points, interval: Interval, extent: Extent) -> Row:
    del extent
    return interpolated_bound(points, interval.stamp).row


def _average(points: Points, interval: Interval, extent: Extent) -> Row:
    del extent
    counted = _count(points, interval)
    if not counted.good:
        return no_data(interval.stamp)
    status = _status_by_count(points, counted)
    if quality_of(status) is Quality.BAD:
        return Row(interval.stamp, with_bits(status, HistoryBits.CALCULATED), 0, None)
    mean = sum([row.value for row in counted.good]) / len(counted.good)
    return Row(interval.stamp, with_bits(status, HistoryBits.CALCULATED), int(BuiltinType.DOUBLE), mean)


def _time_average(points: Points, interval: Interval, extent: Extent) -> Row:
    counted = _count(points, interval)
    usable = [*counted.good, *counted.uncertain]
    if counted.uncertain:
        usable.sort()
    first = interpolated_bound(points, interval.low, stepped=False)
    last = interpolated_bound(points, interval.high, stepped=False)
    uncertain = bool(counted.bad) or bool(counted.uncertain)
    bits = HistoryBits.CALCULATED
    corners = [row for row in usable if interval.low < row.time < interval.high]
    if first.quality is not Quality.BAD:
        corners.insert(0, first.row)
    else:
        uncertain = True
        bits |= HistoryBits.PARTIAL
    corners.append(last.row)
    uncertain = uncertain or any(row.status >> 30 for row in corners)
    length = corners[-1].time - corners[0].time
    if last.quality is Quality.BAD or length <= 0:
        return no_data(interval.stamp)
    if interval.is_short:
        bits |= HistoryBits.PARTIAL
    area = sum((one.value + two.value) * (two.time - one.time) for one, two in pairwise(corners))
    status = with_bits(UNCERTAIN_DATA_SUB_NORMAL if uncertain else 0, bits)
    return Row(interval.stamp, status, int(BuiltinType.DOUBLE), area / (2 * length))


def _extreme(
    choose: Callable[..., float], is_beyond: Callable[[float, float], bool]
) -> Callable[[Points, Interval, Extent], Row]:
    def calculate_extreme(points: Points, interval: Interval, extent: Extent) -> Row:
        counted = _count(points, interval)
        if not counted.good:
            return no_data(interval.stamp)
        values = [row.value for row in counted.good]
        if isnan(sum(values)) and any(map(isnan, values)):  # whatever `choose` says, by where it stands
            return Row(interval.stamp, 0, counted.good[0].type, nan)
        value = choose(values)
        at = [row for row in counted.good if row.value == value]
        uncertain = bool(counted.bad) or any(is_beyond(row.value, value) for row in counted.uncertain)
        is_raw = not uncertain and any(row.time == interval.stamp for row in at)
        bits = _partial(interval, extent) | (HistoryBits.RAW if is_raw else HistoryBits.CALCULATED)
        if len(at) > 1:
            bits |= HistoryBits.MULTI_VALUE
        status = with_bits(UNCERTAIN_DATA_SUB_NORMAL if uncertain else 0, bits)
        return Row(interval.stamp, status, at[0].type, value)

    return calculate_extreme


def _number_of_values(points: Points, interval: Interval, extent: Extent) -> Row:
    counted = _count(points, interval)
    status = with_bits(_status_by_count(points, counted), HistoryBits.CALCULATED | _partial(interval, extent))
    if quality_of(status) is Quality.BAD:
        return Row(interval.stamp, status, 0, None)
    return Row(interval.stamp, status, int(BuiltinType.INT32), len(counted.good))


def _end_value(which: int) -> Callable[[Points, Interval, Extent], Row]:
    def calculate_end(points: Points, interval: Interval, extent: Extent) -> Row:
        values = [row for row in interval.rows(points) if not is_mark(row)]
        if not values:
            return no_data(interval.stamp)
        row = values[which]
        bits = _partial(interval, extent)
        if quality_of(row.status) is Quality.BAD:
            return Row(row.time, with_bits(row.status, bits) if bits else row.status, 0, None)
        return row._replace(status=with_bits(row.status, bits))

    return calculate_end


def _good_ticks(points: Points, interval: Interval, extent: Extent) -> tuple[int, int]:
    """For how long values were Good in an interval, and its length as far as there are values."""
    end = min(interval.high, extent.last + TICKS_PER_MS)
    is_good = simple_bound(points, interval.low).quality is Quality.GOOD
    good, since = 0, interval.low
    for row in points.within(interval.low, end):
        if is_good:
            good += row.time - since
        since, is_good = row.time, not row.status >> 30
    return good + (end - since if is_good else 0), end - interval.low


def _duration_good(points: Points, interval: Interval, extent: Extent) -> Row:
    good, _ = _good_ticks(points, interval, extent)
    status = with_bits(0, HistoryBits.CALCULATED | _partial(interval, extent))
    return Row(interval.stamp, status, int(BuiltinType.DOUBLE), good / TICKS_PER_MS)


def _percent_good(points: Points, interval: Interval, extent: Extent) -> Row:
    good, length = _good_ticks(points, interval, extent)
    status = with_bits(0, HistoryBits.CALCULATED | _partial(interval, extent))
    return Row(interval.stamp, status, int(BuiltinType.DOUBLE), 100 * good / length)


_STATUS: Final = itemgetter(Row._fields.index("status"))
_EXTRAPOLATED: Final = frozenset((Aggregate.INTERPOLATIVE, Aggregate.TIME_AVERAGE))
"""Those that have a value after the end of the data."""
_FUNCTIONS: Final[dict[Aggregate, Callable[[Points, Interval, Extent], Row]]] = {
    Aggregate.INTERPOLATIVE: _interpolative,
    Aggregate.AVERAGE: _average,
    Aggregate.TIME_AVERAGE: _time_average,
    Aggregate.MINIMUM: _extreme(min, lambda one, other: one < other),
    Aggregate.MAXIMUM: _extreme(max, lambda one, other: one > other),
    Aggregate.COUNT: _number_of_values,
    Aggregate.START: _end_value(0),
    Aggregate.END: _end_value(-1),
    Aggregate.DURATION_GOOD: _duration_good,
    Aggregate.PERCENT_GOOD: _percent_good,
}


def has_numbers(rows: Sequence[Row]) -> bool:
    """Whether all values that there are can be calculated with."""
    return all(map(is_number, {row.type for row in rows} - {0}))
