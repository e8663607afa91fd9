"""What values take in memory, and how many of them are found at once."""

from __future__ import annotations

import gc
import sys
from types import FrameType

import pytest

from ua_fleet.history.rows import ListSeries, Row, Rows, value_bytes
from ua_fleet.values import Matrix, NodeId


@pytest.mark.parametrize(
    ("value", "size"),
    [
        ((), 0),
        ((1, 2, 3), 120),
        ([0.5] * 1_000, 40_000),
        ((True, False), 80),
        (("ab", "c"), 2 * 40 + 3 * 4),
        ((b"abc", b""), 2 * 40 + 3),
        (Matrix((1, 2, 3, 4), (2, 2)), 2 * 40 + 4 * 40 + 2 * 40),
        (NodeId(2, "x" * 1_000), 2 * 40 + 4_000),
    ],
)
def test_arrays_are_counted_by_their_elements(value: object, size: int) -> None:
    assert value_bytes(value) == size


def test_an_array_of_numbers_is_counted_without_looking_at_each() -> None:
    calls = 0

    def note(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    value = (1,) * 1_000
    before = sys.getprofile()
    gc.disable()  # a collection calls functions too
    sys.setprofile(note)
    try:
        value_bytes(value)
    finally:
        sys.setprofile(before)
        gc.enable()
    assert 0 < calls < 10


def test_numbers_behind_a_large_value_end_what_is_found_as_large_ones_do() -> None:
    """The first row alone takes all bytes: two are taken in any case, and no third."""
    rows = [Row(0, 0, 15, bytes(200)), *(Row(time, 0, 11, 1.0) for time in range(1, 10))]
    found = Rows(10, 100)
    found.take(rows)
    assert (found, found.is_cut, found.room) == (rows[:2], True, 0)
    assert ListSeries(rows).between(0, 9, 10, most_bytes=100) == rows[:2]
