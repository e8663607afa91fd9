"""Aggregates beyond the standard's tables: time backward, pages, limits, and an independent computation."""

from __future__ import annotations

import random
from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise

import pytest

from tests.unit.history.series import HISTORIAN_1, HISTORIAN_4, NOON, SETTINGS, at, lines, table
from ua_fleet.history.aggregates import Aggregate
from ua_fleet.history.at_times import read_at_times
from ua_fleet.history.blocks import encode_rows
from ua_fleet.history.bounds import Settings
from ua_fleet.history.processed import Failure, ProcessedPage, ProcessedRead, read_processed
from ua_fleet.history.rows import BAD_DATA_LOST, MOST_READ_BYTES, ListSeries, Row, Rows, Series
from ua_fleet.values import TICKS_PER_SECOND

S = TICKS_PER_SECOND
SETTING = Settings(treat_uncertain_as_bad=False)
NUMBERS = ListSeries([Row(NOON + number * S, 0, 11, float(number)) for number in (0, 5, 10)])


def page_of(series: Series, read: ProcessedRead, first: int = 0, most: int = 100) -> ProcessedPage:
    page = read_processed(series, read, first, most)
    assert isinstance(page, ProcessedPage)
    return page


@pytest.mark.parametrize(
    ("aggregate", "forward", "backward"),
    [
        (Aggregate.START, "0:00 0 Good", "0:05 5 Good"),
        (Aggregate.END, "0:05 5 Good", "0:10 10 Good"),
        (Aggregate.MINIMUM, "0:00 0 Good", "0:10 5 Good Calculated"),
        (Aggregate.MAXIMUM, "0:00 5 Good Calculated", "0:10 10 Good"),
        (Aggregate.COUNT, "0:00 2 Good Calculated", "0:10 2 Good Calculated"),
        (Aggregate.TIME_AVERAGE, "0:00 5 Good Calculated", "0:10 5 Good Calculated"),
        (Aggregate.INTERPOLATIVE, "0:00 0 Good", "0:10 10 Good"),
    ],
)
def test_an_interval_excludes_its_end_whichever_way_time_runs(
    aggregate: Aggregate, forward: str, backward: str
) -> None:
    there = ProcessedRead(NOON, NOON + 10 * S, 10_000, aggregate, SETTING)
    back = ProcessedRead(NOON + 10 * S, NOON, 10_000, aggregate, SETTING)
    assert lines(page_of(NUMBERS, there).rows) == [forward]
    assert lines(page_of(NUMBERS, back).rows) == [backward]


def test_start_and_end_have_the_times_and_the_status_of_their_values() -> None:
    read = ProcessedRead(at("0:00"), at("1:40"), 16_000, Aggregate.START, SETTINGS[1])
    assert lines(page_of(HISTORIAN_1, read).rows) == table("""
        0:10 10 Good Partial
        0:20 20 Good
        0:40 Bad
        0:50 50 Good
        1:10 70 Uncertain
        1:20 80 Good Partial
        1:36 NoData""")
    read = ProcessedRead(at("0:00"), at("1:40"), 16_000, Aggregate.END, SETTINGS[1])
    assert [line.split()[0] for line in lines(page_of(HISTORIAN_1, read).rows)] == [
        "0:10", "0:30", "0:40", "1:00", "1:10", "1:30", "1:36",
    ]  # fmt: skip


def test_no_interval_is_one_for_all_and_the_last_one_may_be_short() -> None:
    read = ProcessedRead(at("0:10"), at("0:30"), 0, Aggregate.COUNT, SETTINGS[1])
    assert lines(page_of(HISTORIAN_1, read).rows) == ["0:10 2 Good Calculated"]
    read = ProcessedRead(at("0:10"), at("0:30"), 1e9, Aggregate.COUNT, SETTINGS[1])
    assert lines(page_of(HISTORIAN_1, read).rows) == ["0:10 2 Good Calculated"]
    read = ProcessedRead(at("0:10"), at("0:30"), 15_000, Aggregate.COUNT, SETTINGS[1])
    assert lines(page_of(HISTORIAN_1, read).rows) == ["0:10 2 Good Calculated", "0:25 0 Good Calculated Partial"]


@pytest.mark.parametrize("backward", [False, True])
def test_pages_together_are_the_whole(backward: bool) -> None:
    start, end = (at("1:40"), at("0:00")) if backward else (at("0:00"), at("1:40"))
    for aggregate in Aggregate:
        read = ProcessedRead(start, end, 7_000, aggregate, SETTINGS[1])
        found: list[Row] = []
        first: int | None = 0
        while first is not None:
            page = page_of(HISTORIAN_1, read, first, 4)
            found += page.rows
            first = page.rest
        assert found == page_of(HISTORIAN_1, read).rows
        assert len(found) == 15


def test_a_millennium_of_milliseconds_is_a_page_at_a_time() -> None:
    read = ProcessedRead(0, NOON * 10, 1, Aggregate.AVERAGE, SETTINGS[1])
    page = page_of(HISTORIAN_1, read, 0, 50)
    assert (len(page.rows), page.rest) == (50, 50)


def test_numbers_are_not_made_of_texts_and_flags() -> None:
    for aggregate in Aggregate:
        read = ProcessedRead(at("0:00"), at("1:40"), 50_000, aggregate, SETTINGS[4])
        page = read_processed(HISTORIAN_4, read, 0, 10)
        refused = aggregate in (Aggregate.AVERAGE, Aggregate.TIME_AVERAGE, Aggregate.MINIMUM, Aggregate.MAXIMUM)
        assert (page == Failure(is_too_much=False)) == refused


@pytest.mark.parametrize(("kind", "value"), [(12, "full"), (1, True), (0x8B, (1.0, 2.0))])
def test_no_average_is_made_of_texts_and_flags_around_an_interval(kind: int, value: object) -> None:
    series = ListSeries([Row(NOON + second * S, 0, kind, value) for second in (1, 10_000)])
    for start, end in ((2, 5), (5, 2), (10_001, 10_005)):
        read = ProcessedRead(NOON + start * S, NOON + end * S, 0, Aggregate.TIME_AVERAGE, SETTING)
        assert read_processed(series, read, 0, 10) == Failure(is_too_much=False)


def test_an_interval_of_too_many_values_is_refused_and_a_page_of_them_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ua_fleet.history.processed.PIECE_ROWS", 3)
    monkeypatch.setattr("ua_fleet.history.processed.MOST_ROWS", 10)
    series = ListSeries([Row(NOON + number * S, 0, 11, 1.0) for number in range(100)])
    read = ProcessedRead(NOON, NOON + 100 * S, 5_000, Aggregate.COUNT, SETTINGS[1])
    page = page_of(series, read)
    assert 0 < len(page.rows) < 20
    assert page.rest == len(page.rows)
    whole = ProcessedRead(NOON, NOON + 100 * S, 0, Aggregate.COUNT, SETTINGS[1])
    assert read_processed(series, whole, 0, 10) == Failure(is_too_much=True)


@pytest.mark.parametrize("backward", [False, True])
def test_what_is_calculated_piece_by_piece_is_the_same(monkeypatch: pytest.MonkeyPatch, backward: bool) -> None:
    random_ = random.Random(8)
    times = sorted(random_.sample(range(1_000), 400))
    statuses = random_.choices((0, 0, 0, 0x4000_0000, 0x8000_0000), k=400)
    series = ListSeries(
        [Row(NOON + time * S, status, 11, float(time)) for time, status in zip(times, statuses, strict=True)]
    )
    ends = (NOON + 1_010 * S, NOON - 5 * S) if backward else (NOON - 5 * S, NOON + 1_010 * S)
    for aggregate in Aggregate:
        for interval_s in (7, 100, 500):
            read = ProcessedRead(*ends, interval_s * 1_000, aggregate, SETTING)
            whole = page_of(series, read, most=1_000)
            with monkeypatch.context() as small:
                small.setattr("ua_fleet.history.processed.PIECE_ROWS", 20)
                assert page_of(series, read, most=1_000) == whole
                assert len(whole.rows) == read.count


@pytest.mark.parametrize("backward", [False, True])
def test_intervals_of_large_values_are_calculated_piece_by_piece(backward: bool) -> None:
    """64 MB of values are read at once: six of these intervals; one with more is refused where it needs the values."""
    series = ListSeries([Row(NOON + second * S, 0, 15, bytes([second]) * 1_000_000) for second in range(200)])
    start, end = (NOON + 199 * S, NOON - S) if backward else (NOON, NOON + 200 * S)
    read = ProcessedRead(start, end, 10_000, Aggregate.START, SETTING)
    begins = [start + number * (-10 if backward else 10) * S for number in range(20)]
    first = [begin - 9 * S for begin in begins] if backward else begins
    rows = page_of(series, read).rows
    assert [(row.time, row.value[0]) for row in rows] == [(time, (time - NOON) // S) for time in first]
    for aggregate, expected in ((Aggregate.COUNT, 200), (Aggregate.PERCENT_GOOD, 100.0)):
        whole = ProcessedRead(start, end, 0, aggregate, SETTING)
        [row] = page_of(series, whole).rows
        assert row.value == pytest.approx(expected, rel=0.01)
    whole = ProcessedRead(start, end, 0, Aggregate.START, SETTING)
    assert read_processed(series, whole, 0, 10) == Failure(is_too_much=True)


class Noted(ListSeries):
    """Counts the reads."""

    def __init__(self, rows: list[Row]) -> None:
        super().__init__(rows)
        self.reads = 0

    def between(
        self, first: int, last: int, most: int, *, backward: bool = False, most_bytes: int = MOST_READ_BYTES
    ) -> Rows:
        self.reads += 1
        return super().between(first, last, most, backward=backward, most_bytes=most_bytes)


def images(count: int) -> Noted:
    """One of 16 MB each second: four are read at once."""
    image = bytes(16_000_000)
    return Noted([Row(NOON + second * S, 0, 15, image) for second in range(count)])


@pytest.mark.parametrize("backward", [False, True])
def test_what_is_read_to_count_large_values_has_a_bound(backward: bool) -> None:
    """An interval with more than 512 MB is refused, and a page has as many intervals as that is enough for."""
    series = images(400)
    ends = (NOON + 399 * S, NOON - S) if backward else (NOON, NOON + 400 * S)
    assert read_processed(series, ProcessedRead(*ends, 0, Aggregate.COUNT, SETTING), 0, 10) == Failure(is_too_much=True)
    assert series.reads <= 10
    read = ProcessedRead(*ends, 10_000, Aggregate.COUNT, SETTING)
    counts: list[int] = []
    first: int | None = 0
    while first is not None:
        series.reads = 0
        page = page_of(series, read, first)
        assert page.rows
        assert series.reads <= 14
        counts += [row.value for row in page.rows]
        first = page.rest
    assert counts == [10] * 40


def test_a_page_of_large_values_holds_few_of_them() -> None:
    series = images(100)
    read = ProcessedRead(NOON, NOON + 100 * S, 1_000, Aggregate.START, SETTING)
    page = page_of(series, read)
    assert len(page.rows) <= 8
    assert page.rest == len(page.rows)


def test_an_empty_series_has_no_data() -> None:
    read = ProcessedRead(NOON, NOON + 10 * S, 5_000, Aggregate.PERCENT_GOOD, SETTINGS[1])
    assert lines(page_of(ListSeries([]), read).rows) == ["0:00 NoData", "0:05 NoData"]
    assert lines(read_at_times(ListSeries([]), [NOON], SETTING, simple=False)) == ["0:00 NoData"]


def test_values_at_times_are_looked_for_while_there_is_room() -> None:
    image = bytes(1_000_000)
    series = ListSeries([Row(NOON + second * S, 0, 15, image) for second in range(1_000)])
    taken: list[int] = []

    def times() -> Iterator[int]:
        for second in range(1_000):
            taken.append(second)
            yield NOON + second * S

    room = 3_500_000
    data, count = encode_rows(read_at_times(series, times(), SETTING, simple=False), room, room)
    assert (len(data) // 1_000_000, count, taken) == (3, 3, [0, 1, 2, 3])


def test_values_at_times_are_those_recorded_or_between_them() -> None:
    times = [at(text) for text in ("1:35", "0:10", "0:15", "0:35", "0:40", "0:05")]
    assert lines(read_at_times(HISTORIAN_1, times, SETTING, simple=False)) == table("""
        1:35 90 SubNormal Interpolated
        0:10 10 Good
        0:15 15 Good Interpolated
        0:35 35 SubNormal Interpolated
        0:40 40 SubNormal Interpolated
        0:05 NoData""")
    assert lines(read_at_times(HISTORIAN_1, times, SETTING, simple=True)) == table("""
        1:35 NoData
        0:10 10 Good
        0:15 15 Good Interpolated
        0:35 30 SubNormal Interpolated
        0:40 NoData
        0:05 NoData""")
    stepped = Settings(stepped=True, treat_uncertain_as_bad=False)
    assert lines(read_at_times(HISTORIAN_1, [at("0:15"), at("0:45")], stepped, simple=False)) == table("""
        0:15 10 Good Interpolated
        0:45 30 SubNormal Interpolated""")


def test_a_line_goes_on_behind_the_last_value_where_that_is_wanted() -> None:
    sloped = Settings(treat_uncertain_as_bad=False, sloped_extrapolation=True)
    assert lines(read_at_times(HISTORIAN_1, [at("1:35")], sloped, simple=False)) == ["1:35 95 SubNormal Interpolated"]


def test_integers_stay_integers() -> None:
    series = ListSeries([Row(NOON, 0, 6, 1), Row(NOON + 10 * S, 0, 6, 4)])
    [row] = read_at_times(series, [NOON + 4 * S], SETTING, simple=False)
    assert (row.type, row.value) == (6, 2)


def line_at(good: list[Row], moment: int) -> Fraction | None:
    """The value of a line through Good values, by a search through all of them."""
    before = [row for row in good if row.time <= moment]
    after = [row for row in good if row.time >= moment]
    if not before:
        return None
    if not after:
        return Fraction(before[-1].value)
    one, two = before[-1], after[0]
    if one.time == two.time:
        return Fraction(one.value)
    share = Fraction(moment - one.time, two.time - one.time)
    return Fraction(one.value) + (Fraction(two.value) - Fraction(one.value)) * share


@pytest.mark.parametrize("hundred", range(10))
def test_an_independent_computation_agrees(hundred: int) -> None:
    """Gaps, Bad values and marks; each figure is computed by the definition, moment by moment, with exact fractions."""
    for seed in range(100 * hundred, 100 * (hundred + 1)):
        _compare(seed)


def test_it_agrees_with_what_is_calculated_in_small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ua_fleet.history.processed.PIECE_ROWS", 2)
    for seed in range(100):
        _compare(seed)


def _compare(seed: int) -> None:
    random_ = random.Random(seed)
    seconds = sorted(random_.sample(range(60), random_.randint(1, 30)))
    rows = [
        Row(NOON + second * S, 0, 11, float(random_.randint(-20, 20)))
        if random_.random() < 0.8
        else Row(NOON + second * S, random_.choice((0x8031_0000, BAD_DATA_LOST)), 0, None)
        for second in seconds
    ]
    start, step, count = random_.randint(-10, 40), random_.randint(1, 20), random_.randint(1, 4)
    good = [row for row in rows if row.status == 0]
    for aggregate in Aggregate:
        read = ProcessedRead(NOON + start * S, NOON + (start + step * count) * S, step * 1000, aggregate, SETTING)
        for number, row in enumerate(page_of(ListSeries(rows), read).rows):
            low, high = NOON + (start + number * step) * S, NOON + (start + (number + 1) * step) * S
            inside = [each for each in good if low <= each.time < high]
            values = [each.value for each in inside]
            is_within = high > rows[0].time and low <= rows[-1].time
            expected: object = None
            if aggregate is Aggregate.AVERAGE and values:
                expected = sum(values) / len(values)
            elif aggregate in (Aggregate.MINIMUM, Aggregate.MAXIMUM) and values:
                expected = (min if aggregate is Aggregate.MINIMUM else max)(values)
            elif aggregate is Aggregate.COUNT and is_within:
                all_bad = not inside and any(low <= each.time < high for each in rows)
                expected = None if all_bad else len(inside)
            elif aggregate in (Aggregate.START, Aggregate.END):
                every = [each for each in rows if low <= each.time < high]
                expected = every[0 if aggregate is Aggregate.START else -1].value if every else None
            elif aggregate is Aggregate.INTERPOLATIVE and high > rows[0].time:
                line = line_at(good, low)
                expected = None if line is None else float(line)
            elif aggregate is Aggregate.TIME_AVERAGE and high > rows[0].time:
                expected = _mean_of_line(good, low, high)
            elif aggregate in (Aggregate.DURATION_GOOD, Aggregate.PERCENT_GOOD) and is_within:
                expected = _good_share(rows, low, high, percent=aggregate is Aggregate.PERCENT_GOOD)
            what = (seed, aggregate.name, number, row)
            assert row.value == (pytest.approx(expected) if isinstance(expected, float) else expected), what


def _mean_of_line(good: list[Row], low: int, high: int) -> float | None:
    begin = low if line_at(good, low) is not None else min([row.time for row in good if row.time > low], default=high)
    if begin >= high:
        return None
    moments = sorted({begin, high, *(row.time for row in good if begin < row.time < high)})
    area = Fraction(0)
    for one, two in pairwise(moments):
        first, second = line_at(good, one), line_at(good, two)
        assert first is not None
        assert second is not None
        area += (first + second) / 2 * (two - one)
    return float(area / (high - begin))


def _good_share(rows: list[Row], low: int, high: int, *, percent: bool) -> float:
    """For how long an interval is Good, looked at once in each half of a second."""
    end = min(high, rows[-1].time + S // 1000)
    total = Fraction(0)
    moments = sorted({low, end, *(row.time for row in rows if low < row.time < end)})
    for one, two in pairwise(moments):
        before = [row for row in rows if row.time <= one]
        is_good = bool(before) and before[-1].status == 0
        if is_good and before[-1].time < low:
            # A line to a value that is Bad is Uncertain, and so is the part of it with which an interval begins.
            following = [row for row in rows if row.time > one]
            is_good = bool(following) and following[0].status == 0
        total += (two - one) if is_good else 0
    return float(100 * total / (end - low)) if percent else float(total / (S // 1000))
