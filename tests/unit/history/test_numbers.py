"""What is calculated of numbers at the edge: integers that no Double holds, what is no number, what is infinite."""

from __future__ import annotations

import pytest

from tests.unit.history.series import NOON, lines
from tests.unit.history.test_processed import SETTING, page_of
from ua_fleet.history.aggregates import Aggregate
from ua_fleet.history.at_times import read_at_times
from ua_fleet.history.processed import ProcessedRead
from ua_fleet.history.rows import ListSeries, Row
from ua_fleet.values import TICKS_PER_SECOND

S = TICKS_PER_SECOND
NAN = float("nan")


@pytest.mark.parametrize(
    ("kind", "first", "second", "expected"),
    [
        (8, 2**53 + 1, 2**53 + 1, 2**53 + 1),
        (8, 2**53 + 1, 2**53 + 3, 2**53 + 2),
        (8, 2**63 - 1, 2**63 - 1, 2**63 - 1),
        (8, -(2**63), 2**63 - 1, 0),
        (9, 2**64 - 1, 2**64 - 3, 2**64 - 2),
    ],
)
def test_integers_that_no_double_holds_are_interpolated(kind: int, first: int, second: int, expected: int) -> None:
    series = ListSeries([Row(NOON, 0, kind, first), Row(NOON + 2 * S, 0, kind, second)])
    [row] = read_at_times(series, [NOON + S], SETTING, simple=False)
    assert (row.value, row.status >> 30) == (expected, 0)


@pytest.mark.parametrize("values", [(NAN, 1.0, 3.0, 9.0), (1.0, NAN, 3.0, 9.0), (9.0, 1.0, NAN, 3.0)])
def test_what_is_no_number_counts_as_bad_wherever_it_stands(values: tuple[float, ...]) -> None:
    """OPC 10000-13 does not say what a NaN is; `min` and `max` go by where it stands."""
    rows = [Row(NOON + second * S, 0, 11, value) for second, value in enumerate(values)]
    as_bad = [row if row.value == row.value else Row(row.time, 0x8000_0000, 0, None) for row in rows]
    for aggregate in (Aggregate.MINIMUM, Aggregate.MAXIMUM, Aggregate.AVERAGE, Aggregate.TIME_AVERAGE):
        read = ProcessedRead(NOON, NOON + 4 * S, 2_000, aggregate, SETTING)
        found = page_of(ListSeries(rows), read).rows
        assert found == page_of(ListSeries(as_bad), read).rows
        assert all(row.value is None or row.value == row.value for row in found)
    read = ProcessedRead(NOON, NOON + 4 * S, 0, Aggregate.COUNT, SETTING)
    assert lines(page_of(ListSeries(rows), read).rows) == ["0:00 4 Good Calculated Partial"]


def test_infinite_values_have_a_minimum_and_a_maximum() -> None:
    series = ListSeries([Row(NOON + at * S, 0, 11, float(text)) for at, text in enumerate(("-inf", "inf", "1"))])
    for aggregate, expected in ((Aggregate.MINIMUM, "-inf"), (Aggregate.MAXIMUM, "inf")):
        read = ProcessedRead(NOON, NOON + 2 * S + 1, 0, aggregate, SETTING)
        assert page_of(series, read).rows[0].value == float(expected)


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize(("start", "end"), [(1.2, 2.2), (0.2, 0.8), (1.2, 1.5), (2.5, 2.8), (3.5, 3.8)])
def test_a_line_to_a_bound_goes_past_what_is_no_number(start: float, end: float, backward: bool) -> None:
    """It is the nearest row around an interval, and as little of use as a Bad one."""
    rows = [Row(NOON + second * S, 0, 11, value) for second, value in enumerate((1.0, NAN, 3.0, NAN, 5.0))]
    as_bad = [row if row.value == row.value else Row(row.time, 0x8000_0000, 0, None) for row in rows]
    first, last = [NOON + int(second * S) for second in ((end, start) if backward else (start, end))]
    read = ProcessedRead(first, last, 0, Aggregate.TIME_AVERAGE, SETTING)
    found = page_of(ListSeries(rows), read).rows
    assert found == page_of(ListSeries(as_bad), read).rows
    assert found[0].value is not None


def test_an_extreme_has_the_type_of_its_value() -> None:
    """The type of a node was changed in fleet.yaml: no Int32 holds 2.5."""
    series = ListSeries([Row(NOON, 0, 6, 10), Row(NOON + S, 0, 11, 2.5), Row(NOON + 2 * S, 0, 11, 3.0)])
    read = ProcessedRead(NOON, NOON + 2 * S, 0, Aggregate.MINIMUM, SETTING)
    [row] = page_of(series, read).rows
    assert (row.type, row.value) == (11, 2.5)
