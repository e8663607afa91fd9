"""Events as rows: what they are as bytes, at which times they stand, and in which pages they are read."""

from __future__ import annotations

import random
import struct

import pytest

from tests.unit.history.series import FewBytes
from ua_fleet.history.events import (
    AUDIT_EVENTS,
    EVENTS,
    MOST_LATER,
    BrokenEvent,
    EventPosition,
    EventRecorder,
    KeptEvent,
    MergedSeries,
    encode_event,
    first_position,
    read_events,
)
from ua_fleet.history.raw import RawRead
from ua_fleet.history.rows import BAD_DATA_LOST, ListSeries, Row
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType, datetime_from_ticks

S = TICKS_PER_SECOND
NOW = 134_000_000_000_000_000
MANY = 1_000_000


def event(time: int, text: str = "") -> bytes:
    return encode_event(time, {"Time": time.to_bytes(8, "little"), "Message": text.encode()})


def rows_of(*times: int) -> list[Row]:
    """Events of these Times, as the recorder places them."""
    recorder = EventRecorder()
    return [row for time in times for _, row in recorder.take(time, event(time), NOW + 1_000 * S)]


def told(row: Row) -> bytes | None:
    """A client that wants the event's Time."""
    return None if row.value is None else KeptEvent(row.value).field("Time")


def times(found: list[bytes]) -> list[int]:
    return [int.from_bytes(each, "little") for each in found]


def read(
    series: ListSeries | MergedSeries, wanted: RawRead, at: EventPosition | None = None, most: int = MANY
) -> list[int]:
    """All pages of a request."""
    found: list[bytes] = []
    for _ in range(MANY):
        page = read_events(series, wanted, at, told, most=most, room=MANY, most_rows=MANY)
        found += page.events
        at = page.rest
        if at is None:
            return times(found)
    raise AssertionError


def between(start: int | None, end: int | None, most: int = 0) -> RawRead:
    return RawRead(start, end, most, bounds=False)


def test_fields_come_back_by_their_names() -> None:
    kept = KeptEvent(encode_event(NOW, {"A": b"", "EnabledState/Id": b"12", "Grüße": b"345"}))
    assert kept.time == NOW
    assert [kept.field(name) for name in ("A", "EnabledState/Id", "Grüße", "B")] == [b"", b"12", b"345", None]
    assert KeptEvent(encode_event(NOW, {})).field("A") is None


@pytest.mark.parametrize("data", [b"", b"\x02" + bytes(20), event(NOW)[:15]])
def test_what_is_no_event_is_refused(data: bytes) -> None:
    with pytest.raises((ValueError, struct.error)):
        KeptEvent(data)


def test_rows_have_different_times_and_are_found_by_the_time_of_the_event() -> None:
    rows = rows_of(NOW, NOW, NOW, NOW + 2, NOW - 5)
    assert [row.time for row in rows] == [NOW, NOW + 1, NOW + 2, NOW + 3, NOW + 4]
    series = ListSeries(rows)
    assert read(series, between(NOW, NOW + 1)) == [NOW] * 3
    assert read(series, between(NOW + 1, NOW + 10)) == [NOW + 2]
    assert read(series, between(NOW, NOW)) == [NOW] * 3
    assert read(series, between(NOW + 10, NOW)) == [NOW + 2]
    assert read(series, between(NOW, NOW - 10)) == [NOW - 5] + [NOW] * 3


def test_a_clock_that_is_set_back_does_not_change_the_order() -> None:
    recorder = EventRecorder()
    [(_, first)] = recorder.take(NOW, event(NOW), NOW)
    [(_, second)] = recorder.take(NOW - 3_600 * S, event(NOW - 3_600 * S), NOW - 3_600 * S)
    assert second.time == first.time + 1
    series = ListSeries([first, second])
    assert read(series, between(NOW, NOW + MOST_LATER)) == [NOW, NOW - 3_600 * S]
    assert read(series, between(NOW - 4_000 * S, NOW)) == []


def test_a_time_in_the_future_is_not_believed() -> None:
    [(_, row)] = EventRecorder().take(NOW + 10**6 * S, event(NOW), NOW)
    assert row.time == NOW


def test_a_clock_that_is_ahead_moves_its_own_event_alone() -> None:
    recorder = EventRecorder()
    made = [(NOW + 30 * S, NOW), (NOW + S // 2, NOW + S // 4), *((NOW + n * S, NOW + n * S) for n in range(1, 20))]
    rows = [row for time, wall in made for _, row in recorder.take(time, event(time), wall)]
    assert [row.time for row in rows] == [NOW, NOW + S // 4, *(NOW + n * S for n in range(1, 20))]
    series = ListSeries(rows)
    assert read(series, between(NOW + 5 * S, NOW + 8 * S)) == [NOW + n * S for n in (5, 6, 7)]
    assert read(series, between(NOW, NOW + 1)) == [NOW + 30 * S]
    # Clocks never agree wholly: what is ahead by less than a second is found by its Time.
    for wanted in (between(NOW + S // 2, NOW + S), between(NOW + S - 1, NOW + S // 2 - 1)):
        assert read(series, wanted) == [NOW + S // 2]


@pytest.mark.parametrize(("last", "stopped_at"), [(NOW + 10 * S, NOW + 5 * S), (NOW - S, NOW + 5 * S), (NOW - 1, 0)])
def test_a_restart_is_marked_whatever_the_clock_says(last: int, stopped_at: int) -> None:
    """The server's clock was set back, or the event is older than the end of the last process, or follows at once."""
    recorder = EventRecorder({EVENTS: last}, stopped_at)
    [(_, mark), (_, row)] = recorder.take(NOW, event(NOW), NOW)
    assert (mark.status, mark.value) == (BAD_DATA_LOST, None)
    assert last < mark.time < row.time
    assert len(recorder.take(NOW, event(NOW), NOW)) == 1


@pytest.mark.parametrize("value", [b"", b"\x01\x00\x00", "text", 5.0])
@pytest.mark.parametrize("backward", [False, True])
def test_a_row_that_is_no_event_is_left_out_and_told_of(value: object, backward: bool) -> None:
    rows = rows_of(*range(NOW, NOW + 9))
    rows[4] = Row(NOW + 4, 0, 15, value)
    wanted = between(NOW + 9, NOW - 1) if backward else between(NOW, NOW + 9)
    expected = [NOW + at for at in range(9) if at != 4]
    assert read(ListSeries(rows), wanted, most=3) == (expected[::-1] if backward else expected)
    page = read_events(ListSeries(rows), wanted, None, told, most=MANY, room=MANY, most_rows=MANY)
    assert (len(page.events), page.looked, page.rest) == (8, 9, None)
    [reason] = page.broken
    assert reason.startswith(f"the event of the history at {datetime_from_ticks(NOW + 4)} is broken (")


@pytest.mark.parametrize("data", [event(NOW)[:-1], event(NOW) + b"\x00"])
def test_an_event_whose_fields_do_not_fill_it_is_broken(data: bytes) -> None:
    """Clients get the bytes of a field as they are: a byte less, and they could read nothing of the whole answer."""
    with pytest.raises(ValueError, match="an event of"):
        KeptEvent(data)


def test_what_a_client_wants_of_an_event_may_be_broken() -> None:
    def told_but_one(row: Row) -> bytes | None:
        if row.time == NOW + 1:
            raise BrokenEvent("no such form")
        return told(row)

    wanted = between(NOW, NOW + 9)
    series = ListSeries(rows_of(NOW, NOW + 1, NOW + 2))
    page = read_events(series, wanted, None, told_but_one, most=MANY, room=MANY, most_rows=MANY)
    assert times(page.events) == [NOW, NOW + 2]
    assert len(page.broken) == 1


def test_a_restart_is_marked_once() -> None:
    recorder = EventRecorder({EVENTS: NOW, AUDIT_EVENTS: NOW}, NOW + 5)
    [(key, mark), (_, row)] = recorder.take(NOW + S, event(NOW + S), NOW + S)
    assert (key, mark) == (EVENTS, Row(NOW + 5, BAD_DATA_LOST, 0, None))
    assert row.time == NOW + S
    assert [len(recorder.take(NOW + 2 * S, b"", NOW + 2 * S, is_audit=audit)) for audit in (False, True)] == [1, 1]
    # A store that is new has no gap.
    assert len(EventRecorder().take(NOW, event(NOW), NOW)) == 1


def test_a_restart_is_marked_where_the_store_became_known_later() -> None:
    recorder = EventRecorder()
    recorder.put_behind({EVENTS: NOW, AUDIT_EVENTS: NOW}, NOW + 5, {})
    assert len(recorder.take(NOW + S, event(NOW), NOW + S, is_audit=True)) == 1
    [(_, mark), (_, row)] = recorder.take(NOW + S, event(NOW + S), NOW + S)
    assert (mark, row.time) == (Row(NOW + 5, BAD_DATA_LOST, 0, None), NOW + S)
    # What waits for it has the mark before it, which the backlog has put there; a new store has no gap.
    for stored, waiting, after in (({EVENTS: NOW}, {EVENTS: NOW + 9}, NOW + 10), ({}, {}, NOW)):
        recorder = EventRecorder()
        recorder.put_behind(stored, NOW + 5, waiting)
        [(_, row)] = recorder.take(NOW, event(NOW), NOW)
        assert row.time == after


def test_each_page_is_where_the_one_before_ends() -> None:
    random_ = random.Random(11)
    for _ in range(50):
        moments = sorted(NOW + random_.randrange(300) for _ in range(random_.randrange(1, 700)))
        both = [rows_of(*part) for part in (moments[::2], moments[1::2])]
        series = MergedSeries([random_.choice((ListSeries, FewBytes))(rows) for rows in both])
        start, end = (NOW + random_.randrange(-10, 310) for _ in range(2))
        low, high = min(start, end), max(start, end)
        if start == end:
            expected = [moment for moment in moments if moment == start]
        elif start < end:
            expected = [moment for moment in moments if low <= moment < high]
        else:
            expected = [moment for moment in moments if low < moment <= high]
        found = read(series, between(start, end), most=random_.choice((1, 7, 199, 200, 201, MANY)))
        assert sorted(found) == expected
        assert len(found) == len(expected)


def test_a_number_alone_bounds_each_page() -> None:
    series = ListSeries(rows_of(*range(NOW, NOW + 10)))
    page = read_events(series, between(NOW + 3, None, 4), None, told, most=MANY, room=MANY, most_rows=MANY)
    assert times(page.events) == [NOW + 3, NOW + 4, NOW + 5, NOW + 6]
    assert page.rest == EventPosition(NOW + 7)
    page = read_events(series, between(None, NOW + 1, 4), None, told, most=MANY, room=MANY, most_rows=MANY)
    assert (times(page.events), page.rest) == ([NOW + 1, NOW], None)


def test_work_and_bytes_of_a_page_are_bounded() -> None:
    series = ListSeries(rows_of(*range(NOW, NOW + 1_000)))
    wanted = between(NOW, NOW + 1_000)
    page = read_events(series, wanted, None, lambda row: None, most=MANY, room=MANY, most_rows=300)
    assert (page.events, page.rest, page.looked) == ([], EventPosition(NOW + 300), 300)
    page = read_events(series, wanted, page.rest, lambda row: None, most=MANY, room=MANY, most_rows=700)
    assert (page.events, page.rest, page.looked) == ([], None, 700)
    page = read_events(series, wanted, None, told, most=MANY, room=8 * 3 + 7, most_rows=MANY)
    assert (times(page.events), page.rest) == ([NOW, NOW + 1, NOW + 2], EventPosition(NOW + 3))


@pytest.mark.parametrize("backward", [False, True])
def test_a_request_can_begin_at_its_first_position(backward: bool) -> None:
    series = ListSeries(rows_of(*[NOW + 7] * 5, *range(NOW + 10, NOW + 30), NOW + 2 * S))
    wanted = between(NOW + 20, NOW + 6) if backward else between(NOW + 6, NOW + 20)
    found = read(series, wanted)
    assert len(found) == 15 + backward  # the end is excluded
    assert read(series, wanted, first_position(wanted)) == found
    for alone in (between(NOW + 7, None, 3), between(None, NOW + 12, 3), between(NOW + 7, NOW + 7)):
        assert read(series, alone, first_position(alone)) == read(series, alone)


def test_marks_of_gaps_are_rows_like_others() -> None:
    rows = [*rows_of(NOW), Row(NOW + 5, BAD_DATA_LOST, 0, None), *rows_of(NOW + 10)]
    page = read_events(
        ListSeries(rows), between(NOW, NOW + 20), None, lambda row: bytes(1), most=MANY, room=MANY, most_rows=MANY
    )
    assert len(page.events) == 3
    assert rows[0].type == int(BuiltinType.BYTE_STRING)
