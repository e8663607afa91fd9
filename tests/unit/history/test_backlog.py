"""Rows that wait: their bounds, and the marks of what was lost."""

from __future__ import annotations

from ua_fleet.history.backlog import Backlog, Full, row_bytes
from ua_fleet.history.rows import BAD_DATA_LOST, Row
from ua_fleet.values import NodeId

KEY, OTHER, NEW = NodeId(2, 1001), NodeId(2, 1002), NodeId(2, 1003)
STRING = 12


def text(time: int, size: int) -> Row:
    return Row(time, 0, STRING, "x" * size)


def mark(time: int) -> Row:
    return Row(time, BAD_DATA_LOST, 0, None)


def test_large_values_are_bounded_by_their_bytes() -> None:
    backlog = Backlog(1_000, 3 * row_bytes(text(1, 10_000)))
    backlog.add([(KEY, text(time, 10_000)) for time in range(1, 6)])
    assert len(backlog) == 3
    assert backlog.lost == {Full.BYTES: 2}
    assert backlog.size == 3 * row_bytes(text(1, 10_000))


def test_rows_that_give_way_leave_half_of_the_room() -> None:
    backlog = Backlog(4, 100_000)
    backlog.add([(OTHER, text(time, 1)) for time in range(1, 5)], gives_way=True)
    backlog.add([(KEY, text(time, 1)) for time in range(1, 3)])
    assert backlog.take().rows == [(OTHER, text(1, 1)), (OTHER, text(2, 1)), (KEY, text(1, 1)), (KEY, text(2, 1))]
    assert backlog.lost == {Full.ROWS: 2}
    backlog = Backlog(100, 4 * row_bytes(text(1, 100)))
    for gives_way in (True, False):
        backlog.add([(NodeId(2, gives_way), text(time, 100)) for time in range(4)], gives_way=gives_way)
    assert (len(backlog), backlog.lost) == (4, {Full.BYTES: 4})


def test_what_the_store_has_been_given_counts_until_it_has_it() -> None:
    backlog = Backlog(2, 10_000)
    backlog.add([(KEY, text(1, 1)), (KEY, text(2, 1))])
    batch = backlog.take()
    backlog.add([(KEY, text(3, 1))])
    assert (len(backlog), backlog.lost[Full.ROWS]) == (0, 1)
    assert backlog.size == batch.size
    backlog.restore()
    assert backlog.take().rows == batch.rows
    backlog.taken()
    assert backlog.take().rows == [(KEY, mark(3))]


def test_each_node_that_lost_rows_gets_a_mark_as_soon_as_there_is_room() -> None:
    backlog = Backlog(1, 10_000)
    backlog.add([(KEY, text(1, 1)), (KEY, text(2, 1)), (OTHER, text(3, 1)), (KEY, text(4, 1))])
    assert backlog.lost == {Full.ROWS: 3}
    backlog.take()
    backlog.taken()
    assert backlog.take().rows == [(KEY, mark(2)), (OTHER, mark(3))]
    backlog.taken()
    backlog.add([(KEY, text(5, 1))])
    assert backlog.take().rows == [(KEY, text(5, 1))]


def test_a_value_larger_than_the_memory_is_lost_alone() -> None:
    backlog = Backlog(100, 50_000)
    backlog.add([(KEY, text(1, 1)), (KEY, text(2, 100_000)), (KEY, text(3, 1))])
    assert backlog.take().rows == [(KEY, text(1, 1)), (KEY, mark(2)), (KEY, text(3, 1))]


def test_a_row_takes_what_its_value_takes() -> None:
    sizes = [
        row_bytes(Row(1, 0, 11, 0.5)),
        row_bytes(Row(1, 0, 15, bytes(100))),
        row_bytes(Row(1, 0, STRING, "x" * 100)),
        row_bytes(Row(1, 0, 11 | 0x80, memoryview(bytes(800)).cast("d"))),
        row_bytes(Row(1, 0, STRING | 0x80, ("x" * 100,) * 20)),
    ]
    number = sizes[0]
    assert [size - number for size in sizes] == [0, 100, 400, 800, 20 * 440]


def test_rows_that_came_before_the_store_was_known_go_behind_what_it_has() -> None:
    backlog = Backlog(100, 100_000)
    new = NodeId(2, 1003)
    backlog.add(
        [(KEY, text(50, 1)), (KEY, text(60, 2)), (OTHER, text(150, 3)), (OTHER, text(151, 4)), (new, text(7, 5))]
    )
    assert backlog.put_behind({KEY: 100, OTHER: 100}, 110, 130) == {KEY: 131, OTHER: 151, new: 7}
    assert backlog.take().rows == [
        (KEY, mark(110)),
        (KEY, text(130, 1)),  # at the start of this process, since the store has something at its own time
        (KEY, text(131, 2)),
        (OTHER, mark(110)),
        (OTHER, text(150, 3)),
        (OTHER, text(151, 4)),
        (new, text(7, 5)),
    ]


def test_rows_that_follow_what_the_store_has_at_once_have_no_gap_before_them() -> None:
    backlog = Backlog(100, 100_000)
    backlog.add([(KEY, text(101, 1))])
    assert backlog.put_behind({KEY: 100}, 0, 0) == {KEY: 101}
    assert backlog.take().rows == [(KEY, text(101, 1))]
    assert backlog.size == row_bytes(text(101, 1))


def test_what_was_lost_before_the_store_was_there_is_marked_from_its_last_row_on() -> None:
    backlog = Backlog(1, 10_000)
    backlog.add([(KEY, text(100, 1)), (OTHER, text(101, 1)), (KEY, text(102, 1)), (NEW, text(103, 1))])
    waiting = backlog.put_behind({KEY: 5, OTHER: 6}, 10, 99)
    assert waiting == {KEY: 102, OTHER: 10, NEW: 103}
    assert backlog.take().rows == [(KEY, mark(10)), (KEY, text(100, 1))]
    assert backlog.taken() == [OTHER, KEY, NEW]
    assert backlog.take().rows == [(OTHER, mark(10)), (KEY, mark(102)), (NEW, mark(103))]


def test_marks_of_what_was_lost_are_behind_a_store_whose_clock_was_ahead() -> None:
    backlog = Backlog(1, 10_000)
    backlog.add([(KEY, text(100, 1)), (OTHER, text(101, 1)), (KEY, text(102, 1))])
    assert backlog.put_behind({KEY: 1_000, OTHER: 2_000}, 2_001, 99) == {KEY: 1_002, OTHER: 2_001}
    assert backlog.take().rows == [(KEY, text(1_001, 1))]
    backlog.taken()
    assert backlog.take().rows == [(OTHER, mark(2_001)), (KEY, mark(1_002))]
