"""What is kept of values, at which times, and what is marked as missing."""

from __future__ import annotations

import math
import tracemalloc
from itertools import pairwise
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.history.backlog import Backlog, Full
from ua_fleet.history.recorder import Recorder
from ua_fleet.history.rows import BAD_DATA_LOST, Row
from ua_fleet.history.rules import Rule
from ua_fleet.values import TICKS_PER_SECOND, NodeId

KEY, OTHER = NodeId(2, 1001), NodeId(2, 1002)
S = TICKS_PER_SECOND
DOUBLE, STRING = 11, 12
SILENT = 0x8031_0000


class Taken:
    """A recorder of one node, and what it has kept."""

    def __init__(self, rule: Rule | None, **options: Any) -> None:
        self.recorder = Recorder(lambda key: rule if key == KEY else None, **options)
        self.rows: list[Row] = []

    def give(
        self, second: float, value: Any, *, status: int = 0, kind: int = DOUBLE, wall: float | None = None
    ) -> None:
        time = int(second * S)
        change = ValueChanged(KEY, kind, value, status, time, True)
        self.rows += [row for _, row in self.recorder.take(change, time if wall is None else int(wall * S))]

    def poll(self, second: float) -> None:
        self.rows += [row for _, row in self.recorder.poll(int(second * S))]

    @property
    def told(self) -> list[tuple[float, Any]]:
        return [(row.time / S, row.value) for row in self.rows]


def test_each_change_is_kept_with_the_end_of_what_was_the_same() -> None:
    taken = Taken(Rule())
    for second, value in enumerate([1.0, 1.0, 1.0, 2.0, 3.0, 3.0]):
        taken.give(second, value)
    assert taken.told == [(0, 1.0), (2, 1.0), (3, 2.0), (4, 3.0)]
    assert [row.time / S for _, row in taken.recorder.finish()] == [5]
    assert taken.recorder.finish() == []


def test_a_node_without_a_rule_is_not_recorded() -> None:
    taken = Taken(None)
    taken.give(1, 1.0)
    taken.give(2, 2.0)
    assert taken.rows == []


def test_within_the_deadband_nothing_is_kept() -> None:
    taken = Taken(Rule(deadband=0.5))
    for second, value in enumerate([1.0, 1.4, 0.6, 1.5, 1.6]):
        taken.give(second, value)
    assert taken.told == [(0, 1.0), (3, 1.5), (4, 1.6)]


def test_a_slow_drift_is_seen() -> None:
    """Each value is held against the one that was kept, not against the one before."""
    taken = Taken(Rule(deadband=1.0))
    for second in range(100):
        taken.give(second, second / 10)
    kept = [value for _, value in taken.told]
    assert max(later - earlier for earlier, later in pairwise(kept)) <= 1.2
    assert len(kept) < 25


def test_nan_is_the_same_as_nan() -> None:
    taken = Taken(Rule())
    for second, value in enumerate([math.nan, math.nan, 1.0, math.nan]):
        taken.give(second, value)
    assert [second for second, _ in taken.told] == [0, 1, 2, 3]
    taken = Taken(Rule())
    for second in range(4):
        taken.give(second, math.nan)
    assert len(taken.rows) == 1


def test_texts_and_arrays_have_no_deadband() -> None:
    taken = Taken(Rule(deadband=10.0))
    for second, value in enumerate(["a", "a", "b"]):
        taken.give(second, value, kind=STRING)
    for second, array in enumerate([(1.0, 2.0), (1.0, 2.0), (1.0, 3.0)], start=3):
        taken.give(second, array, kind=DOUBLE | 0x80)
    assert [value for _, value in taken.told] == ["a", "a", "b", (1.0, 2.0), (1.0, 2.0), (1.0, 3.0)]


def test_at_most_each_second_and_the_last_one_always() -> None:
    taken = Taken(Rule(at_most_each_s=1))
    for second, value in ((0, 1.0), (0.2, 2.0), (0.9, 3.0)):
        taken.give(second, value)
    assert taken.recorder.next_due() == S
    taken.poll(0.99)
    assert taken.told == [(0, 1.0)]
    taken.poll(1)
    assert taken.told == [(0, 1.0), (0.9, 3.0)]
    assert taken.recorder.next_due() is None
    taken.give(1.5, 4.0)
    taken.give(1.6, 3.0)
    taken.poll(5)
    assert taken.told == [(0, 1.0), (0.9, 3.0)]
    taken.give(6, 7.0)
    assert taken.told == [(0, 1.0), (0.9, 3.0), (6, 7.0)]


def test_the_end_of_a_flat_part_is_kept_at_most_each_second_too() -> None:
    """Otherwise a line would lead from its beginning to the next value, through values that never were."""
    taken = Taken(Rule(at_most_each_s=1, at_least_each_s=60))
    for number in range(120):
        taken.give(number, 20.0 if number < 59 else 100.0)
        taken.poll(number)
    assert taken.told == [(0, 20.0), (58, 20.0), (59, 100.0), (119, 100.0)]
    taken = Taken(Rule(at_most_each_s=1))
    for second, value in ((0.0, 1.0), (30, 1.0), (30.1, 2.0), (30.2, 3.0)):
        taken.give(second, value)
    assert taken.told == [(0, 1.0), (30, 1.0)]
    assert taken.recorder.next_due() == 31.1 * S
    taken.poll(31.1)
    assert taken.told == [(0, 1.0), (30, 1.0), (30.2, 3.0)]


def test_a_flat_part_that_is_shorter_than_the_pause_has_no_end_of_its_own() -> None:
    taken = Taken(Rule(at_most_each_s=10))
    for second, value in ((0, 1.0), (9, 1.0), (10, 2.0)):
        taken.give(second, value)
    assert taken.told == [(0, 1.0), (10, 2.0)]


def at(rows: list[tuple[float, Any]], second: float) -> float:
    """What a line from row to row has at a time."""
    for (first, before), (last, after) in pairwise(rows):
        if first <= second <= last:
            return float(before + (after - before) * (second - first) / (last - first))
    raise AssertionError("not within the rows")


@given(st.lists(st.tuples(st.integers(1, 5), st.integers(0, 2), st.integers(1, 15)), min_size=1, max_size=12))
def test_at_most_each_second_is_so_in_the_long_run_and_what_rests_is_seen(runs: list[tuple[int, int, int]]) -> None:
    """Each run is a value that comes so often, with a pause in tenths of a second."""
    taken, given_values, tenth = Taken(Rule(at_most_each_s=1)), list[tuple[float, float]](), 0
    for pause, value, times in runs:
        for _ in range(times):
            while (due := taken.recorder.next_due()) is not None and due <= tenth * S // 10:
                taken.poll(due / S)
            given_values.append((tenth / 10, float(value)))
            taken.give(*given_values[-1])
            tenth += pause
    taken.poll(tenth / 10 + 1)
    taken.rows += [row for _, row in taken.recorder.finish()]
    seconds = [second for second, _ in taken.told[:-1]]
    for first, begin in enumerate(seconds):
        for places, end in enumerate(seconds[first:]):
            assert end - begin >= places - 1.001
    for second, number in given_values:
        beside = [other for when, other in given_values if second - 2.01 <= when <= second + 1.01]
        if set(beside) == {number} and given_values[0][0] < second - 2.01 and second + 1.01 < given_values[-1][0]:
            assert at(taken.told, second) == number


def test_a_change_of_quality_does_not_wait() -> None:
    taken = Taken(Rule(deadband=100, at_most_each_s=100))
    taken.give(0, 1.0)
    taken.give(1, 2.0)
    taken.give(2, 2.0, status=SILENT)
    taken.give(3, 2.0)
    assert [(row.time / S, row.status) for row in taken.rows] == [(0, 0), (1, 0), (2, SILENT), (3, 0)]


def test_the_same_value_is_kept_each_so_often() -> None:
    taken = Taken(Rule(at_least_each_s=10))
    for second in range(26):
        taken.give(second, 1.0)
    assert taken.told == [(0, 1.0), (10, 1.0), (20, 1.0)]


def test_a_value_that_is_older_than_what_is_stored_comes_behind_it() -> None:
    """A robot whose silence was stored last repeats its old value after a restart: it is well again from then on."""
    taken = Taken(Rule(), before={KEY: 20 * S}, stopped_at=30 * S)
    taken.give(10, 1.0, wall=40)
    taken.give(10, 2.0, wall=41)
    taken.give(42, 3.0)
    assert [(row.time / S, row.value) for row in taken.rows] == [(30, None), (40, 1.0), (41, 2.0), (42, 3.0)]
    assert taken.rows[0].status == BAD_DATA_LOST
    taken.recorder.forget(KEY)
    taken.give(42, 3.0, wall=50)
    assert [row.time / S for row in taken.rows[4:]] == [42 + 1 / S, 50]


def test_a_status_without_a_new_time_has_the_servers() -> None:
    """A source that falls silent keeps its last value and its time."""
    taken = Taken(Rule())
    taken.give(10, 1.0, wall=11)
    taken.give(10, 1.0, status=SILENT, wall=14)
    taken.give(10, 1.0, wall=15)
    assert [row.time / S for row in taken.rows] == [10, 14, 15]


def test_a_clock_that_is_wrong_gets_the_servers_time() -> None:
    taken = Taken(Rule())
    taken.give(1e9, 1.0, wall=20)
    taken.give(21, 2.0, wall=22)
    taken.give(5, 3.0, wall=23)
    assert [row.time / S for row in taken.rows] == [20, 21, 23]


@given(st.lists(st.tuples(st.integers(-5, 90), st.integers(0, 3), st.sampled_from([0, SILENT])), max_size=40))
def test_times_strictly_increase(given_values: list[tuple[int, int, int]]) -> None:
    taken = Taken(Rule(at_most_each_s=2, deadband=1))
    for wall, (second, value, status) in enumerate(given_values):
        taken.give(second, float(value), status=status, wall=wall)
        taken.poll(wall)
    times = [row.time for row in [*taken.rows, *[row for _, row in taken.recorder.finish()]]]
    assert times == sorted(set(times))


def test_a_restart_is_marked_before_the_first_value_after_it() -> None:
    taken = Taken(Rule(), before={KEY: 100 * S}, stopped_at=130 * S)
    taken.give(200, 1.0)
    taken.give(201, 2.0)
    assert [(row.time / S, row.status) for row in taken.rows] == [(130, BAD_DATA_LOST), (200, 0), (201, 0)]
    fresh = Taken(Rule(), before={OTHER: 100 * S}, stopped_at=130 * S)
    fresh.give(200, 1.0)
    assert len(fresh.rows) == 1


def test_the_restart_of_a_server_is_marked_for_a_robot_whose_clock_is_behind() -> None:
    taken = Taken(Rule(), before={KEY: 100 * S}, stopped_at=3_700 * S)
    taken.give(2_000, 1.0, wall=5_600)
    assert [(row.time, row.status) for row in taken.rows] == [(100 * S + 1, BAD_DATA_LOST), (2_000 * S, 0)]


def test_values_of_a_robot_whose_clock_is_far_behind_get_the_servers_time() -> None:
    """They would be removed at once, since they are older than any value is kept."""
    day = 86_400
    taken = Taken(Rule(days=2))
    taken.give(0, 1.0, wall=2 * day)
    taken.give(1, 2.0, wall=2 * day + 2)
    taken.give(2, 3.0, wall=2 * day + 3)
    taken.give(2 * day - 5, 4.0, wall=2 * day + 4)
    assert [row.time / S for row in taken.rows] == [0, 2 * day + 2, 2 * day + 3, 2 * day + 4]


def test_at_most_each_second_holds_for_a_robot_whose_clock_is_behind() -> None:
    taken = Taken(Rule(at_most_each_s=10))
    for tenth in range(1, 1_000):
        taken.poll(5_000 + tenth / 10)
        taken.give(tenth / 10, float(tenth), wall=5_000 + tenth / 10)
    assert 9 <= len(taken.rows) <= 11
    assert all(later - earlier > 9.8 for (earlier, _), (later, _) in pairwise(taken.told))


def test_a_value_that_comes_and_goes_while_it_may_not_be_kept_takes_no_memory() -> None:
    taken = Taken(Rule(at_most_each_s=1e6))
    taken.give(0, 0.0)
    tracemalloc.start()
    try:
        for tenth in range(1, 20_000):
            taken.give(tenth / 10, float(tenth % 2))
        used, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert used < 20_000
    taken.give(2_000, 1.0)
    taken.poll(999_999)
    assert taken.told == [(0, 0.0)]
    taken.poll(1_000_000)
    assert taken.told == [(0, 0.0), (2_000, 1.0)]


def test_what_waits_is_kept_when_its_own_pause_is_over() -> None:
    taken = Taken(Rule(at_most_each_s=10))
    taken.give(0, 0.0)
    taken.give(1, 1.0)
    taken.give(2, 1.0, status=SILENT)  # does not wait
    taken.give(3, 1.0)
    taken.give(4, 2.0)
    taken.poll(10)
    assert [row.time / S for row in taken.rows] == [0, 1, 2, 3]
    assert taken.recorder.next_due() == 13 * S
    taken.poll(13)
    assert [row.time / S for row in taken.rows] == [0, 1, 2, 3, 4]


def test_a_node_of_which_rows_were_lost_is_kept_again_as_it_is_now() -> None:
    taken = Taken(Rule())
    taken.give(0, 1.0)
    taken.give(1, 2.0)
    assert taken.recorder.repeat([KEY, OTHER], 5 * S) == [(KEY, Row(5 * S, 0, DOUBLE, 2.0))]
    taken.give(6, 2.0)
    taken.give(7, 2.0)
    assert taken.recorder.repeat([KEY], 9 * S) == [(KEY, Row(7 * S, 0, DOUBLE, 2.0))]
    assert taken.recorder.repeat([KEY], 3 * S) == [(KEY, Row(7 * S + 1, 0, DOUBLE, 2.0))]
    assert taken.recorder.finish() == []


def row(time: int) -> Row:
    return Row(time, 0, DOUBLE, float(time))


def test_what_comes_while_the_backlog_is_full_is_counted_and_marked() -> None:
    backlog = Backlog(3, 1_000_000)
    backlog.add([(KEY, row(1)), (OTHER, row(2)), (KEY, row(3)), (KEY, row(4)), (KEY, row(5)), (OTHER, row(6))])
    assert (backlog.lost, len(backlog)) == ({Full.ROWS: 3}, 3)
    backlog.take()
    backlog.restore()
    assert backlog.take().rows == [(KEY, row(1)), (OTHER, row(2)), (KEY, row(3))]
    backlog.taken()
    backlog.add([(KEY, row(7)), (OTHER, row(8))])
    marks = [(KEY, 4, BAD_DATA_LOST), (OTHER, 6, BAD_DATA_LOST)]
    found = [(key, each.time, each.status) for key, each in backlog.take().rows]
    assert found == [*marks, (KEY, 7, 0)]
    assert backlog.lost == {Full.ROWS: 4}  # a mark takes a place, too
    backlog.taken()
    assert [(key, each.time, each.status) for key, each in backlog.take().rows] == [(OTHER, 8, BAD_DATA_LOST)]


def test_a_value_that_waits_is_kept_when_its_node_goes() -> None:
    taken = Taken(Rule(at_most_each_s=10.0))
    taken.give(10, 20.0)
    taken.give(11, 95.0)
    assert taken.told == [(10, 20.0)]
    assert [(row.time / S, row.value) for _, row in taken.recorder.forget(KEY)] == [(11, 95.0)]
    assert taken.recorder.forget(KEY) == []
    taken.poll(60)
    taken.give(11, 96.0, wall=61)
    assert taken.rows[-1].time > 11 * S
