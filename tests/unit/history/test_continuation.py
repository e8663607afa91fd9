"""Continuation points: they say all, and only who has the secret can make one."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.history.aggregates import Aggregate
from ua_fleet.history.bounds import Settings
from ua_fleet.history.continuation import Continuations
from ua_fleet.history.events import EventPosition
from ua_fleet.history.processed import ProcessedRead
from ua_fleet.history.raw import Phase, Position, RawRead
from ua_fleet.history.rows import LATEST

POINTS = Continuations(b"secret")
TIMES = st.one_of(st.none(), st.integers(0, LATEST))
RAW = RawRead(5, 9, 3, True)
AT = Position(Phase.WITHIN, 7)


@given(TIMES, TIMES, st.integers(0, 0xFFFF_FFFF), st.booleans(), st.sampled_from(Phase), st.integers(0, LATEST))
def test_a_point_of_raw_values_says_all(
    start: int | None, end: int | None, most: int, bounds: bool, phase: Phase, time: int
) -> None:
    read = RawRead(start, end, most, bounds)
    point = POINTS.of_raw("2;i=1", read, Position(phase, time))
    assert POINTS.read_raw("2;i=1", point) == (read, Position(phase, time))


@given(
    st.integers(0, LATEST),
    st.integers(0, LATEST),
    st.floats(0, 1e15),
    st.sampled_from(Aggregate),
    st.builds(Settings, st.booleans(), st.booleans(), st.integers(0, 255), st.integers(0, 255), st.booleans()),
    st.integers(0, 0xFFFF_FFFF),
)
def test_a_point_of_aggregates_says_all(
    start: int, end: int, interval_ms: float, aggregate: Aggregate, settings: Settings, number: int
) -> None:
    read = ProcessedRead(start, end, interval_ms, aggregate, settings)
    assert POINTS.read_processed("2;i=1", POINTS.of_processed("2;i=1", read, number)) == (read, number)


@given(TIMES, TIMES, st.integers(0, 0xFFFF_FFFF), st.integers(0, LATEST), st.integers(0, 255), st.binary())
def test_a_point_of_events_says_all_but_the_filter(
    start: int | None, end: int | None, most: int, time: int, skipped: int, filter_data: bytes
) -> None:
    read = RawRead(start, end, most, bounds=False)
    point = POINTS.of_events("i=2253", read, filter_data, EventPosition(time, skipped))
    assert POINTS.read_events("i=2253", filter_data, point) == (read, EventPosition(time, skipped))
    assert POINTS.read_events("i=2253", filter_data + b"x", point) is None
    assert POINTS.read_raw("i=2253", point) is None


def test_only_a_point_of_this_store_node_and_kind_is_taken() -> None:
    point = POINTS.of_raw("2;i=1", RAW, AT)
    assert POINTS.read_raw("2;i=2", point) is None
    assert Continuations(b"other").read_raw("2;i=1", point) is None
    assert POINTS.read_processed("2;i=1", point) is None


@given(st.integers(0, 46), st.integers(1, 255))
def test_a_point_that_was_changed_is_refused(index: int, change: int) -> None:
    point = bytearray(POINTS.of_raw("2;i=1", RAW, AT))
    point[index % len(point)] ^= change
    assert POINTS.read_raw("2;i=1", bytes(point)) is None


@given(st.binary(max_size=80))
def test_any_bytes_are_refused(data: bytes) -> None:
    assert POINTS.read_raw("2;i=1", data) is None
    assert POINTS.read_processed("2;i=1", data) is None
