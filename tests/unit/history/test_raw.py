"""ReadRaw: the examples of OPC 10000-11 table 1, and pages that together are the whole."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.history.series import FewBytes
from ua_fleet.history.raw import Phase, Position, RawRead, read_raw
from ua_fleet.history.rows import BAD_BOUND_NOT_FOUND, ListSeries, Row

SERIES = ListSeries([Row(time, 0, 11, float(time)) for time in (500, 502, 503, 505, 506)])
FIRST, LAST = "first", "last"

# Start, end (None: not given), values of a page, bounds; the values, and whether there are more.
EXAMPLES: list[tuple[int | None, int | None, int, bool, list[int | str], bool]] = [
    (500, 505, 0, True, [500, 502, 503, 505], False),
    (500, 505, 0, False, [500, 502, 503], False),
    (501, 504, 0, True, [500, 502, 503, 505], False),
    (501, 504, 0, False, [502, 503], False),
    (505, 500, 0, True, [505, 503, 502, 500], False),
    (505, 500, 0, False, [505, 503, 502], False),
    (504, 501, 0, True, [505, 503, 502, 500], False),
    (504, 501, 0, False, [503, 502], False),
    (459, 505, 0, True, [FIRST, 500, 502, 503, 505], False),
    (459, 505, 0, False, [500, 502, 503], False),
    (501, 507, 0, True, [500, 502, 503, 505, 506, LAST], False),
    (501, 507, 0, False, [502, 503, 505, 506], False),
    (500, 505, 3, True, [500, 502, 503], True),
    (500, 505, 3, False, [500, 502, 503], False),
    (501, 504, 3, True, [500, 502, 503], True),
    (501, 504, 3, False, [502, 503], False),
    (505, 500, 3, True, [505, 503, 502], True),
    (505, 500, 3, False, [505, 503, 502], False),
    (504, 501, 3, True, [505, 503, 502], True),
    (504, 501, 3, False, [503, 502], False),
    (459, 505, 3, True, [FIRST, 500, 502], True),
    (459, 505, 3, False, [500, 502, 503], False),
    (501, 507, 3, True, [500, 502, 503], True),
    (501, 507, 3, False, [502, 503, 505], True),
    (500, None, 3, True, [500, 502, 503], True),
    (500, None, 3, False, [500, 502, 503], True),
    (500, None, 6, True, [500, 502, 503, 505, 506, LAST], False),
    (500, None, 6, False, [500, 502, 503, 505, 506], False),
    (507, None, 6, True, [506, LAST], False),
    (507, None, 6, False, [], False),
    (None, 506, 3, True, [506, 505, 503], True),
    (None, 506, 3, False, [506, 505, 503], True),
    (None, 506, 6, True, [506, 505, 503, 502, 500, LAST], False),
    (None, 506, 6, False, [506, 505, 503, 502, 500], False),
    (None, 448, 6, True, [500, LAST], False),
    (None, 448, 6, False, [], False),
    (448, 448, 0, True, [FIRST, 500], False),
    (448, 448, 0, False, [], False),
    (448, 448, 1, True, [FIRST], True),
    (448, 448, 1, False, [], False),
    (448, 448, 2, True, [FIRST, 500], False),
    (500, 500, 0, True, [500, 502], False),
    (500, 500, 0, False, [500], False),
    (500, 500, 1, True, [500], True),
    (500, 500, 1, False, [500], False),
    (501, 501, 0, True, [500, 502], False),
    (501, 501, 0, False, [], False),
    (501, 501, 1, True, [500], True),
    (501, 501, 1, False, [], False),
]


def told(row: Row | None, read: RawRead) -> int | str:
    if row is None:
        return LAST
    if row.status == BAD_BOUND_NOT_FOUND:
        assert row.value is None
        return FIRST if row.time == read.begin else LAST
    return row.time


@pytest.mark.parametrize(("start", "end", "most", "bounds", "expected", "more"), EXAMPLES)
def test_an_example_of_the_standard(
    start: int | None, end: int | None, most: int, bounds: bool, expected: list[int | str], more: bool
) -> None:
    read = RawRead(start, end, most, bounds)
    assert read.is_valid
    page = read_raw(SERIES, read, None, 1000)
    assert [told(row, read) for row in page.rows] == expected
    assert (page.rest is not None) == more


def test_one_time_alone_says_too_little() -> None:
    assert not RawRead(500, None, 0, True).is_valid
    assert not RawRead(None, None, 5, True).is_valid


TIMES = st.integers(0, 40)


@given(st.sets(TIMES), TIMES, TIMES, st.booleans(), st.integers(1, 5), st.booleans())
def test_pages_together_are_the_whole(
    times: set[int], start: int, end: int, bounds: bool, page_size: int, few_bytes: bool
) -> None:
    rows = [Row(time, 0, 15, bytes(time % 7 * 20)) for time in times]
    series = FewBytes(rows) if few_bytes else ListSeries(rows)
    read = RawRead(start, end, 0, bounds)
    whole = read_raw(ListSeries(rows), read, None, 1000)
    assert whole.rest is None
    found: list[Row | None] = []
    at: Position | None = None
    for _ in range(60):
        page = read_raw(series, read, at, page_size)
        assert len(page.rows) <= page_size
        found += page.rows
        if page.rest is None:
            break
        assert page.rows
        at = page.rest
    else:
        raise AssertionError("it has no end")
    assert found == whole.rows


def test_a_page_of_large_values_takes_little_memory() -> None:
    """16 MB, though 2,000 values were allowed."""
    image = bytes(1_000_000)
    series = ListSeries([Row(time, 0, 15, image) for time in range(2_000)])
    page = read_raw(series, RawRead(0, 2_000, 2_000, bounds=False), None, 2_000)
    assert (len(page.rows), page.rest) == (16, Position(Phase.WITHIN, 16))
    page = read_raw(series, RawRead(1_999, 0, 2_000, bounds=True), None, 2_000)
    assert (len(page.rows), page.rest) == (17, Position(Phase.WITHIN, 1_982))
