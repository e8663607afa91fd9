"""What is looked through where few values are usable: once for all intervals of a page, and all times of a request."""

from __future__ import annotations

import random
from typing import Any

import pytest

from tests.unit.history.series import NOON
from ua_fleet.history.at_times import TooMuch, read_at_times
from ua_fleet.history.bounds import Points, Settings, interpolated_bound
from ua_fleet.history.rows import MOST_READ_BYTES, ListSeries, Row, Rows
from ua_fleet.history.window import window
from ua_fleet.values import TICKS_PER_SECOND, Quality

S = TICKS_PER_SECOND
GOOD, UNCERTAIN, BAD = 0, 0x4000_0000, 0x8000_0000


def rows_of(statuses: list[int]) -> list[Row]:
    return [Row(NOON + second * S, status, 11, float(second)) for second, status in enumerate(statuses)]


class Indexed(list[Row]):
    """Counts the rows that are taken by their index."""

    taken = 0

    def __getitem__(self, index: Any) -> Any:
        self.taken += 1
        return super().__getitem__(int(index))


class Counted(ListSeries):
    """Counts the rows that are read."""

    read = 0

    def between(
        self, first: int, last: int, most: int, *, backward: bool = False, most_bytes: int = MOST_READ_BYTES
    ) -> Rows:
        found = super().between(first, last, most, backward=backward, most_bytes=most_bytes)
        self.read += len(found)
        return found


def test_rows_that_are_not_usable_are_not_gone_through_for_each_interval() -> None:
    rows = Indexed(rows_of([GOOD, *[UNCERTAIN] * 5_000, GOOD]))
    points = Points(rows, Settings())
    for second in range(1_000, 1_100):
        assert interpolated_bound(points, NOON + second * S + 1).quality is Quality.UNCERTAIN
    assert rows.taken <= 1_000


@pytest.mark.parametrize("is_bad", [True, False])
def test_the_nearest_usable_rows_are_those_that_a_walk_finds(is_bad: bool) -> None:
    random_ = random.Random(1)
    settings = Settings(treat_uncertain_as_bad=is_bad)
    for _ in range(200):
        rows = rows_of(random_.choices((GOOD, 0x0400, UNCERTAIN, BAD), k=random_.randrange(12)))
        usable = [(at, row) for at, row in enumerate(rows) if settings.quality(row) is not Quality.BAD]
        points = Points(rows, settings)
        for half in range(-1, 25):
            time = NOON + half * S // 2
            before, after = [one for one in usable if one[1].time < time], [one for one in usable if one[1].time > time]
            assert points.usable_before(time) == (before[-1] if before else None)
            assert points.usable_after(time) == (after[0] if after else None)


@pytest.mark.parametrize("backward", [False, True])
def test_what_was_read_around_one_time_is_there_for_the_next_one(backward: bool) -> None:
    series = Counted(rows_of([GOOD, *[UNCERTAIN] * 8_000, GOOD]))
    times = [NOON + second * S + 1 for second in range(3_000, 4_000)]
    found = list(read_at_times(series, times[::-1] if backward else times, Settings(), simple=False))
    assert {row.status >> 30 for row in found} == {2}
    assert series.read <= 4_000


@pytest.mark.parametrize("simple", [False, True])
@pytest.mark.parametrize("sloped", [False, True])
def test_a_value_at_a_time_does_not_depend_on_the_other_times(
    monkeypatch: pytest.MonkeyPatch, simple: bool, sloped: bool
) -> None:
    monkeypatch.setattr("ua_fleet.history.window.SEARCHED", 4)
    monkeypatch.setattr("ua_fleet.history.at_times.SEARCHED", 4)
    random_ = random.Random(2)
    for _ in range(200):
        weights = random_.choice(((1, 1, 1), (1, 9, 2), (9, 1, 1)))
        rows = rows_of(random_.choices((GOOD, UNCERTAIN, BAD), weights, k=random_.randrange(30)))
        settings = Settings(random_.random() < 0.3, random_.random() < 0.7, sloped_extrapolation=sloped)
        times = [NOON + random_.randrange(-2, 62) * S // 2 for _ in range(20)]
        if random_.random() < 0.6:
            times.sort(reverse=random_.random() < 0.5)
        series = ListSeries(rows)
        found = list(read_at_times(series, times, settings, simple=simple))
        assert found == [next(read_at_times(series, [time], settings, simple=simple)) for time in times]
        if not simple:
            each = [window(series, [], time, time - 1, settings) for time in times]
            assert found == [interpolated_bound(points, time).row for points, time in zip(each, times, strict=True)]


def test_images_that_are_not_usable_are_not_kept_in_memory() -> None:
    """Each time has 64 MB of them on each side; what is found beyond goes on from there."""
    image = bytes(16_000_000)
    series = Counted([Row(NOON + second * S, UNCERTAIN if second else 0, 15, image) for second in range(40)])
    times = [NOON + 20 * S + 1] * 8
    found = list(read_at_times(series, times, Settings(), simple=False))
    assert [row.status >> 30 for row in found][-1] == 1
    assert series.read <= 42


def test_large_values_that_are_not_usable_are_not_looked_through_without_an_end() -> None:
    """1,000 times in disorder would read 70 GB, and nothing else of the store meanwhile."""
    image = bytes(1_000_000)
    series = Counted([Row(NOON + second * S, UNCERTAIN, 15, image) for second in range(3_000)])
    times = [NOON + second * 70 % 3_000 * S + 1 for second in range(300)]
    found = read_at_times(series, times, Settings(), simple=False)
    with pytest.raises(TooMuch):
        list(found)
    assert series.read <= 1_200
    usable = Counted([Row(NOON + second * S, GOOD, 15, image) for second in range(3_000)])
    assert len(list(read_at_times(usable, times, Settings(stepped=True), simple=False))) == 300
