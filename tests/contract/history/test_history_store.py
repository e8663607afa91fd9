"""What every store of history does. A further kind of database is one more entry of STORES."""

from __future__ import annotations

import contextlib
import itertools
import random
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.postgres import PASSWORD, USER, Postgres
from ua_fleet.errors import StorageUnavailable
from ua_fleet.history.events import (
    AUDIT_EVENTS,
    EVENTS,
    EventPosition,
    EventRecorder,
    KeptEvent,
    MergedSeries,
    encode_event,
    read_events,
)
from ua_fleet.history.raw import RawRead, read_raw
from ua_fleet.history.recorder import Kept
from ua_fleet.history.rows import EARLIEST, LATEST, ListSeries, Row
from ua_fleet.history.store import HistoryStore, node_of, node_text
from ua_fleet.storage.history_store import HISTORY_FILE, SqliteHistory
from ua_fleet.values import TICKS_PER_SECOND, NodeId

KEY, OTHER = NodeId(2, 1001), NodeId(2, "1002.pose.x")
S = TICKS_PER_SECOND
DAY = 86_400 * S
NOW = 134_000_000_000_000_000
DOUBLE, STRING, BYTES = 11, 12, 15
HUGE = 2**40


Open = Callable[[], HistoryStore]
STORES = ["sqlite", pytest.param("postgres", marks=pytest.mark.needs("postgres"))]
_number = itertools.count(1)


@pytest.fixture(params=STORES)
def opened(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Open]:
    """Opens the same store again and again."""
    if request.param == "sqlite":
        yield lambda: SqliteHistory(tmp_path / "state" / HISTORY_FILE)
        return
    from ua_fleet.storage.postgres_history import PostgresHistory

    postgres: Postgres = request.getfixturevalue("postgres")
    with postgres.database(f"contract_{next(_number)}") as url:
        yield lambda: PostgresHistory(url, USER, PASSWORD)


@pytest.fixture
def store(opened: Open) -> Iterator[HistoryStore]:
    with contextlib.closing(opened()) as made:
        yield made


def row(second: float, value: object = None, kind: int = DOUBLE) -> Row:
    return Row(NOW + int(second * S), 0, kind, float(second) if value is None else value)


def numbers(key: NodeId, *seconds: float) -> list[Kept]:
    return [(key, row(second)) for second in seconds]


def all_of(store: HistoryStore, key: NodeId) -> list[Row]:
    return store.series(key).between(EARLIEST, LATEST, 1_000_000)


def tend(store: HistoryStore, now: int = NOW, days: float = 1e6, most_bytes: int = HUGE) -> None:
    for _ in range(10_000):
        if not store.tend(now, lambda _key: days, most_bytes):
            return
    raise AssertionError("it never has done all")


def test_names_of_nodes_come_back() -> None:
    for key in (KEY, OTHER, NodeId(4, "a;b=c;i=5")):
        assert node_of(node_text(key)) == key


def test_rows_come_back_in_their_order(store: HistoryStore) -> None:
    mixed: list[Kept] = [
        (KEY, row(1)),
        (OTHER, row(1.5, "text", STRING)),
        (KEY, Row(NOW + 2 * S, 0x8031_0000, 0, None)),
    ]
    store.write(mixed, NOW)
    store.write([(KEY, row(3, (1.0, 2.0), DOUBLE | 0x80))], NOW)
    assert all_of(store, KEY) == [row(1), Row(NOW + 2 * S, 0x8031_0000, 0, None), row(3, (1.0, 2.0), DOUBLE | 0x80)]
    assert all_of(store, OTHER) == [row(1.5, "text", STRING)]
    assert all_of(store, NodeId(2, 9)) == []
    assert store.last_times() == {KEY: NOW + 3 * S, OTHER: NOW + int(1.5 * S)}


def test_what_is_there_already_is_left_out(store: HistoryStore) -> None:
    """So a batch of which nobody knows whether it was taken may be given again."""
    store.write(numbers(KEY, 1, 2, 3), NOW)
    store.write([*numbers(KEY, 2, 3), (KEY, row(3, 99.0)), *numbers(KEY, 4, 4)], NOW)
    assert all_of(store, KEY) == [row(second) for second in (1, 2, 3, 4)]


def test_it_is_there_after_a_restart(opened: Open) -> None:
    with contextlib.closing(opened()) as store:
        secret = store.secret
        assert store.stopped_at == 0
        store.write(numbers(KEY, 1, 2), NOW + 5)
        store.write([], NOW + 7)
    with contextlib.closing(opened()) as store:
        assert (store.secret, store.stopped_at) == (secret, NOW + 7)
        assert len(secret) >= 16
        assert store.last_times() == {KEY: NOW + 2 * S}
        store.write(numbers(OTHER, 1), NOW)
        store.write(numbers(KEY, 3), NOW)
        assert all_of(store, KEY) == [row(second) for second in (1, 2, 3)]
        assert all_of(store, OTHER) == [row(1)]


def test_a_second_process_is_refused(opened: Open) -> None:
    with contextlib.closing(opened()), pytest.raises(StorageUnavailable, match="in use"):
        opened()


@pytest.mark.parametrize("compacted", [False, True])
def test_any_part_of_it_is_read_in_both_directions(store: HistoryStore, compacted: bool) -> None:
    random_ = random.Random(3)
    rows = [row(second) for second in sorted(random_.sample(range(20_000), 4_500))]
    for at in range(0, len(rows), 700):
        store.write([(KEY, each) for each in rows[at : at + 700]], NOW)
        if compacted:
            tend(store)
    expected, series = ListSeries(rows), store.series(KEY)
    for _ in range(200):
        first, last = (NOW + random_.randrange(-100, 20_100) * S for _ in range(2))
        most, backward = random_.choice((1, 2, 999, 1_000, 1_001, 5_000)), random_.random() < 0.5
        assert series.between(first, last, most, backward=backward) == expected.between(
            first, last, most, backward=backward
        )
    assert series.between(EARLIEST, LATEST, 0) == []


@pytest.mark.parametrize("compacted", [False, True])
@pytest.mark.parametrize("backward", [False, True])
def test_rows_of_large_values_are_bounded_by_their_bytes(store: HistoryStore, compacted: bool, backward: bool) -> None:
    random_ = random.Random(6)
    rows = [row(second, random_.randbytes(random_.choice((10, 9_000))), BYTES) for second in range(2_100)]
    store.write([(KEY, each) for each in rows], NOW)
    if compacted:
        tend(store)
    series, expected = store.series(KEY), rows[::-1] if backward else rows
    found, low, high = list[Row](), EARLIEST, LATEST
    for _ in range(100):
        part = series.between(low, high, 10_000, backward=backward, most_bytes=500_000)
        sizes = [len(each.value) for each in part]
        assert sum(sizes[:-1]) < 500_000
        found += part
        low, high = (low, part[-1].time - 1) if backward else (part[-1].time + 1, high)
        if not part.is_cut:
            break
        assert sum(sizes) >= 500_000
    assert found == expected
    first, second = series.between(EARLIEST, LATEST, 10, backward=backward, most_bytes=1)
    assert [first, second] == expected[:2]


def test_a_block_of_large_values_takes_little_memory(store: HistoryStore) -> None:
    """A page that begins in a block has all of it decoded."""
    random_ = random.Random(7)
    rows = [row(second, random_.randbytes(20_000), BYTES) for second in range(2_000)]
    for at in range(0, len(rows), 500):
        store.write([(KEY, each) for each in rows[at : at + 500]], NOW)
    tend(store)
    tracemalloc.start()
    try:
        assert store.series(KEY).between(EARLIEST, LATEST, 1) == rows[:1]
        assert tracemalloc.get_traced_memory()[1] < 12_000_000
    finally:
        tracemalloc.stop()
    assert all_of_pages(store) == rows


def all_of_pages(store: HistoryStore) -> list[Row]:
    """Those of a node, read as clients do."""
    read, at, found = RawRead(NOW - 1, NOW + DAY, 0, bounds=False), None, list[Row]()
    while True:
        page = read_raw(store.series(KEY), read, at, 2_000)
        found += [each for each in page.rows if each is not None]
        if (at := page.rest) is None:
            return found


def test_compaction_makes_it_small(store: HistoryStore) -> None:
    random_ = random.Random(5)
    time, rows = NOW, list[Kept]()
    for _ in range(50_000):
        time += S // 10 + random_.randrange(-4_000, 4_000)
        rows.append((KEY, Row(time, 0, DOUBLE, random_.gauss(20, 3))))
    for at in range(0, len(rows), 2_500):
        store.write(rows[at : at + 2_500], NOW)
    tend(store)
    assert all_of(store, KEY) == [each for _, each in rows]
    assert store.used_bytes() / len(rows) <= 24


def test_what_is_too_old_is_removed(store: HistoryStore) -> None:
    for hour in range(0, 240, 2):
        store.write(
            [(key, Row(NOW + hour * DAY // 24 + n, 0, DOUBLE, 1.0)) for n in range(40) for key in (KEY, OTHER)], NOW
        )
    tend(store, NOW)
    days = {KEY: 2.0, OTHER: 5.0}
    now = NOW + 10 * DAY
    while store.tend(now, lambda key: days[key], HUGE):
        pass
    for key, kept in days.items():
        found = all_of(store, key)
        assert found
        assert found[-1].time == NOW + 238 * DAY // 24 + 39
        # A block goes as a whole, so that a part of a day may stay for longer.
        assert now - int(kept * DAY) - DAY <= found[0].time
    store.write([(KEY, Row(now, 0, DOUBLE, 2.0))], now)
    assert all_of(store, KEY)[-1].value == 2.0


def test_what_is_too_old_is_removed_after_the_clock_was_set_back(store: HistoryStore) -> None:
    store.write(numbers(KEY, *range(10)), NOW)
    tend(store, NOW + 10_000 * DAY, days=1e6)
    tend(store, NOW + 100 * DAY, days=30)
    assert all_of(store, KEY) == []


def test_blocks_go_up_to_the_time_from_which_on_rows_are_kept(store: HistoryStore) -> None:
    store.write([*numbers(KEY, *range(5_000)), *numbers(OTHER, 1)], NOW)
    tend(store)
    late, days = NOW + 10 * DAY + 2_000 * S, {KEY: 10.0, OTHER: 100.0}
    while store.tend(late, lambda key: days[key], HUGE):
        pass
    assert all_of(store, OTHER)
    assert [each.value for each in all_of(store, KEY)] == [float(second) for second in range(2_000, 5_000)]


def test_the_oldest_goes_when_there_is_too_much(store: HistoryStore) -> None:
    rows = [row(second, f"{second:0200}", STRING) for second in range(8_000)]
    for at in range(0, len(rows), 1_000):
        store.write([(KEY, each) for each in rows[at : at + 1_000]], NOW)
    before = store.used_bytes()
    tend(store, NOW + 9_000 * S, most_bytes=before // 2)
    assert store.used_bytes() <= before // 2
    found = all_of(store, KEY)
    assert found == rows[-len(found) :]
    assert len(found) > 1_000


def test_much_that_is_too_much_is_removed_in_pieces(store: HistoryStore) -> None:
    """Writes have their turn between them, and nothing is said of the limit before all is done."""
    days, large = 10, "x" * 20_000
    for day in range(days):
        now = NOW + day * DAY
        store.write([(KEY, Row(now + at * DAY // 40, 0, STRING, large)) for at in range(40)], now)
    most, late = store.used_bytes() // 3, NOW + days * DAY
    sizes = [store.used_bytes()]
    while store.tend(late, lambda _key: 1e6, most):
        sizes.append(store.used_bytes())
        assert store.over_limit == ""
        store.write([(OTHER, Row(late + len(sizes), 0, DOUBLE, 1.0))], late)
    assert sum(later < earlier for earlier, later in itertools.pairwise(sizes)) >= 3
    assert (store.over_limit, store.used_bytes() <= most) == ("", True)
    assert len(all_of(store, OTHER)) == len(sizes) - 1
    found = all_of(store, KEY)
    assert found[-1].time >= NOW + 9 * DAY
    assert found[0].time >= NOW + 5 * DAY


def test_audit_events_give_way_before_all_else(store: HistoryStore) -> None:
    """Strangers make them: they take a quarter of the store at most, and push out nothing else."""
    random_, values = random.Random(8), numbers(KEY, *range(3_000))
    store.write(values, NOW)
    kept = [(AUDIT_EVENTS, row(second, random_.randbytes(1_000), BYTES)) for second in range(3_000, 7_500)]
    for at in range(0, len(kept), 1_500):
        store.write(kept[at : at + 1_500], NOW)
    tend(store, NOW + 8_000 * S)
    before = store.used_bytes()
    assert len(all_of(store, AUDIT_EVENTS)) == 4_500
    tend(store, NOW + 9_000 * S, most_bytes=8_000_000)
    assert all_of(store, KEY) == [each for _, each in values]
    found = all_of(store, AUDIT_EVENTS)
    assert found == [each for _, each in kept[-len(found) :]]
    # A block goes as a whole, so that a thousand may be gone beyond the quarter that makes room.
    assert 400 <= len(found) < 2_000
    assert store.used_bytes() < before - 2_000_000
    store.write([(AUDIT_EVENTS, row(9_000, b"new", BYTES))], NOW)
    assert all_of(store, AUDIT_EVENTS) == [*found, row(9_000, b"new", BYTES)]


def test_audit_events_within_their_part_stay(store: HistoryStore) -> None:
    kept = [(AUDIT_EVENTS, row(second, bytes(1_000), BYTES)) for second in range(1_500)]
    store.write(kept, NOW)
    tend(store, NOW + 2_000 * S, most_bytes=8_000_000)
    assert all_of(store, AUDIT_EVENTS) == [each for _, each in kept]


def test_blocks_that_span_a_large_part_of_the_time_go_too(store: HistoryStore) -> None:
    random_ = random.Random(7)
    rows = [row(second, random_.gauss(20, 3)) for second in range(20_000)]
    store.write([(KEY, each) for each in rows], NOW)
    tend(store)
    most = store.used_bytes() * 3 // 4
    tend(store, NOW + 21_000 * S, most_bytes=most)
    assert store.used_bytes() <= most
    found = all_of(store, KEY)
    assert found == rows[-len(found) :]
    assert 1_000 <= len(found) < len(rows)


def test_a_limit_that_cannot_be_reached_is_told(store: HistoryStore) -> None:
    rows = [row(second, float(second)) for second in range(3_000)]
    store.write([(KEY, each) for each in rows], NOW)
    tend(store, NOW + 3_000 * S)
    assert store.over_limit == ""
    tend(store, NOW + 4_000 * S, most_bytes=1)
    assert "takes 0 MB with its old values removed, and history.megabytes is 0; raise that" in store.over_limit
    tend(store, NOW + 5_000 * S)
    assert store.over_limit == ""


def test_events_come_back_in_pages(opened: Open) -> None:
    """Of both series, from rows and from blocks, in both directions, also after a restart."""
    recorder, random_, time = EventRecorder(), random.Random(9), NOW
    times: list[int] = []
    with contextlib.closing(opened()) as store:
        for _ in range(5):
            batch: list[Kept] = []
            for _ in range(1_000):
                time += random_.choice((0, 0, 10, S))
                data = encode_event(time, {"Time": time.to_bytes(8, "little"), "Message": random_.randbytes(40)})
                batch += recorder.take(time, data, time, is_audit=random_.random() < 0.2)
                times.append(time)
            store.write(batch, time)
        tend(store, time)
    with contextlib.closing(opened()) as store:
        series = MergedSeries([store.series(EVENTS), store.series(AUDIT_EVENTS)])
        for start, end in ((NOW, time + 1), (times[900], times[4_100]), (times[4_100], times[900])):
            found: list[int] = []
            at: EventPosition | None = None
            for number in itertools.count():
                page = read_events(
                    series,
                    RawRead(start, end, 0, bounds=False),
                    at,
                    lambda row: KeptEvent(row.value).field("Time"),
                    most=1_000,
                    room=HUGE,
                    most_rows=HUGE,
                )
                found += [int.from_bytes(event, "little") for event in page.events]
                at = page.rest
                if at is None:
                    break
                assert number < 10
            low, high = min(start, end), max(start, end)
            expected = [each for each in times if low <= each <= high and each != end]
            assert sorted(found) == expected
            # Two of one Time stand beside each other in each direction; all else is in order.
            assert all(
                abs(earlier - later) < S
                for earlier, later in zip(found, sorted(found, reverse=end < start), strict=True)
            )
        assert set(store.last_times()) == {EVENTS, AUDIT_EVENTS}


def test_what_is_too_old_goes_while_a_node_is_compacted(store: HistoryStore) -> None:
    """Rows of a megabyte make a block for each two of them: a minute after its time the removal goes first."""
    large = bytes(1_000_000)
    store.write(
        [
            (OTHER, row(-10 * DAY / S)),
            *((KEY, row(at, large[: 10**6 if at < 12 else 1], BYTES)) for at in range(2_011)),
        ],
        NOW,
    )
    late = NOW + 2 * 60 * S
    assert store.tend(NOW, lambda _key: 5, HUGE)
    for _ in range(2):
        assert store.tend(late, lambda key: 5 if key == OTHER else 100, HUGE)
    assert not all_of(store, OTHER)
    assert len(all_of(store, KEY)) == 2_011
    assert store.tend(late, lambda _key: 100, HUGE)  # the compaction goes on
