"""The SQLite store beyond its contract: what can be wrong with its file, and a kill at any moment."""

from __future__ import annotations

import contextlib
import gc
import itertools
import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from ua_fleet.errors import StorageUnavailable
from ua_fleet.history.blocks import decode_value, encode_block
from ua_fleet.history.rows import EARLIEST, LATEST, Row
from ua_fleet.storage import history_store
from ua_fleet.storage.history_store import HISTORY_FILE, SqliteHistory
from ua_fleet.values import TICKS_PER_SECOND as SECOND
from ua_fleet.values import NodeId

KEY = NodeId(2, 1001)
ROWS = [(KEY, Row(number, 0, 11, float(number))) for number in range(1, 6_000)]


def full(path: Path) -> None:
    with contextlib.closing(SqliteHistory(path)) as store:
        store.write(ROWS, 9_000)
        while store.tend(9_000, lambda _key: 1e6, 2**40):
            pass


def test_a_file_of_a_newer_version_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / HISTORY_FILE
    full(path)
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA user_version=99")
    with pytest.raises(StorageUnavailable, match="newer"):
        SqliteHistory(path)


def test_a_truncated_file_says_so(tmp_path: Path) -> None:
    path = tmp_path / HISTORY_FILE
    full(path)
    path.write_bytes(path.read_bytes()[:20_000])
    with pytest.raises(StorageUnavailable, match=r"broken|malformed"), contextlib.closing(SqliteHistory(path)) as store:
        store.series(KEY).between(EARLIEST, LATEST, 10_000)


def test_rows_are_made_without_a_search_for_garbage_among_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / HISTORY_FILE
    full(path)
    was_on: list[bool] = []

    def decode(*given: Any) -> Row:
        was_on.append(gc.isenabled())
        return decode_value(*given)

    def broken(*_given: Any) -> Row:
        raise ZeroDivisionError

    monkeypatch.setattr(history_store, "decode_value", decode)
    with contextlib.closing(SqliteHistory(path)) as store:
        store.series(KEY).between(EARLIEST, LATEST, 10_000)
        assert set(was_on) == {False}
        assert gc.isenabled()
        gc.disable()
        try:
            store.series(KEY).between(EARLIEST, LATEST, 10_000)
            assert not gc.isenabled()  # it was off before
        finally:
            gc.enable()
        monkeypatch.setattr(history_store, "decode_value", broken)
        with pytest.raises(ZeroDivisionError):
            store.series(KEY).between(EARLIEST, LATEST, 10_000)
        assert gc.isenabled()


def test_a_block_that_is_broken_costs_the_read_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / HISTORY_FILE
    full(path)
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("UPDATE block SET data = substr(data, 1, 60) WHERE first = 1")
        connection.commit()
    with contextlib.closing(SqliteHistory(path)) as store:
        with pytest.raises(StorageUnavailable, match="broken"):
            store.series(KEY).between(EARLIEST, LATEST, 10_000)
        assert store.series(KEY).between(1_500, LATEST, 10_000)[0].time == 1_500


def noted_connections(monkeypatch: pytest.MonkeyPatch) -> list[sqlite3.Connection]:
    """Those that are opened from now on."""
    connections: list[sqlite3.Connection] = []
    connect = sqlite3.connect

    def noted(*arguments: Any, **options: Any) -> sqlite3.Connection:
        connections.append(connect(*arguments, **options))
        return connections[-1]

    monkeypatch.setattr(sqlite3, "connect", noted)
    return connections


def counted(made: Iterator[int]) -> int:
    """Takes the next number, and says that SQLite goes on."""
    next(made)
    return 0


def test_a_page_costs_the_same_however_many_blocks_come_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the steps of SQLite's machine."""
    steps: dict[int, int] = {}
    for count in (10, 2_000):
        path = tmp_path / str(count) / HISTORY_FILE
        with contextlib.closing(SqliteHistory(path)) as store:
            store.write(ROWS[:1], 1)
        pairs = [(Row(10 * at, 0, 11, 1.0), Row(10 * at + 5, 0, 11, 2.0)) for at in range(1, count + 1)]
        with contextlib.closing(sqlite3.connect(path)) as connection:
            connection.executemany(
                "INSERT INTO block VALUES (1, ?, ?, ?)",
                [(first.time, last.time, encode_block((first, last))) for first, last in pairs],
            )
            connection.execute("DELETE FROM row")
            connection.commit()
        with monkeypatch.context() as noting:
            connections = noted_connections(noting)
            store = SqliteHistory(path)
        with contextlib.closing(store):
            series, made = store.series(KEY), itertools.count()
            connections[0].set_progress_handler(partial(counted, made), 1)
            for backward in (False, True):
                found = series.between(10 * count - 2, LATEST, 2, backward=backward)
                assert found == list(pairs[-1][::-1] if backward else pairs[-1])
            steps[count] = next(made)
    assert steps[2_000] < 1.5 * steps[10]


@pytest.mark.parametrize(
    ("begins", "ends", "said"),
    [
        ("PRAGMA max_page_count=12", "PRAGMA max_page_count=1000000", "the disk is full; free some space"),
        ("PRAGMA query_only=1", "PRAGMA query_only=0", "cannot be written"),
    ],
)
def test_what_a_full_or_read_only_file_does_not_take_is_taken_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, begins: str, ends: str, said: str
) -> None:
    connections = noted_connections(monkeypatch)
    with contextlib.closing(SqliteHistory(tmp_path / HISTORY_FILE)) as store:
        store.write(ROWS[:10], 10)
        connections[0].execute(begins)
        with pytest.raises(StorageUnavailable, match=said) as told:
            store.write(ROWS[10:], 9_000)
        assert "\n" not in str(told.value)
        assert store.series(KEY).between(EARLIEST, LATEST, 10_000) == [row for _, row in ROWS[:10]]
        connections[0].execute(ends)
        store.write(ROWS[10:], 9_000)
        assert store.series(KEY).between(EARLIEST, LATEST, 10_000) == [row for _, row in ROWS]


def test_a_compaction_that_failed_is_done_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_rows: object) -> bytes:
        raise StorageUnavailable("the disk is full")

    path = tmp_path / HISTORY_FILE
    with contextlib.closing(SqliteHistory(path)) as store:
        store.write(ROWS, 9_000)
        with monkeypatch.context() as broken:
            broken.setattr(history_store, "encode_block", fails)
            with pytest.raises(StorageUnavailable, match="full"):
                store.tend(9_000, lambda _key: 1e6, 2**40)
        while store.tend(9_000, lambda _key: 1e6, 2**40):
            pass
    with contextlib.closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT count(*) FROM block").fetchone() == (4,)


def test_what_is_too_much_is_removed_while_a_node_is_compacted(tmp_path: Path) -> None:
    """A node whose rows make a block each never ends: a minute after its time the removal goes first."""
    large = bytes(1_000_000)
    rows = [(KEY, Row(number * SECOND, 0, 15, large[: 1_000_000 if number < 40 else 1])) for number in range(1, 2_100)]
    now, megabytes = 2_100 * SECOND, 10_000_000
    with contextlib.closing(SqliteHistory(tmp_path / HISTORY_FILE)) as store:
        store.write(rows, now)
        for _ in range(3):
            assert store.tend(now, lambda _key: 1e6, megabytes)
        assert store.used_bytes() > megabytes
        assert store.tend(now + 119 * SECOND, lambda _key: 1e6, megabytes)
        assert store.used_bytes() < megabytes


def test_what_is_too_much_is_removed_of_some_nodes_at_once(tmp_path: Path) -> None:
    def remaining(store: SqliteHistory, keys: list[NodeId]) -> list[Row]:
        return [row for key in keys for row in store.series(key).between(EARLIEST, LATEST, 100)]

    keys = [NodeId(2, 1001 + number) for number in range(250)]
    rows = [(key, Row(at * SECOND, 0, 15, bytes(1_000))) for at in range(1, 41) for key in keys]
    with contextlib.closing(SqliteHistory(tmp_path / HISTORY_FILE)) as store:
        store.write(rows, 40 * SECOND)
        most = store.used_bytes() * 9 // 10
        pieces: list[int] = []
        for _ in range(3):
            before = len(remaining(store, keys))
            assert store.tend(41 * SECOND, lambda _key: 1e6, most)
            pieces.append(before - len(remaining(store, keys)))
        assert pieces == [200, 200, 100], "two rows of each node, of 100 at once"


def test_a_removal_that_fails_holds_up_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_given: object) -> None:
        raise StorageUnavailable("full")

    with contextlib.closing(SqliteHistory(tmp_path / HISTORY_FILE)) as store:
        store.write([*ROWS, *[(NodeId(2, 1002), Row(10_000, 0, 15, bytes(100_000)))]], 9_000)
        now, most = 9_000 + 119 * SECOND, 100_000
        store.tend(9_000, lambda _key: 1e6, most)
        with monkeypatch.context() as broken:
            broken.setattr(store, "_remove_old", fails)
            with pytest.raises(StorageUnavailable, match="full"):
                store.tend(now, lambda _key: 1e6, most)
        assert store.tend(now, lambda _key: 1e6, most)
        assert store.used_bytes() > most, "it looks at ages, and removes in the next round"
        while store.tend(now, lambda _key: 1e6, most):
            pass
        assert store.used_bytes() > most
        while store.tend(now + 60 * SECOND, lambda _key: 1e6, most):
            pass
        assert store.used_bytes() <= most


def test_the_age_of_all_nodes_is_looked_at_while_one_is_compacted(tmp_path: Path) -> None:
    other, day = NodeId(2, 1002), 86_400 * SECOND
    large = bytes(1_000_000)
    rows = [(KEY, Row(10 * day + at, 0, 15, large[: 1_000_000 if at < 40 else 1])) for at in range(2_100)]
    now = 11 * day
    with contextlib.closing(SqliteHistory(tmp_path / HISTORY_FILE)) as store:
        store.write([(other, Row(day, 0, 11, 1.0)), *rows], now)
        store.tend(now, lambda _key: 5, 2**40)
        for _ in range(2):
            assert store.tend(now + 119 * SECOND, lambda _key: 5, 2**40)
        assert not store.series(other).between(EARLIEST, LATEST, 1)
        assert store.series(KEY).between(EARLIEST, LATEST, 1)
        more = 0
        while store.tend(now + 119 * SECOND, lambda _key: 5, 2**40):
            more += 1
        assert more > 10  # blocks of the other node, which goes on from where it was


_WRITER = """
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from ua_fleet.history.rows import Row
from ua_fleet.storage.history_store import SqliteHistory
from ua_fleet.values import NodeId
store = SqliteHistory(Path(sys.argv[1]))
key, number = NodeId(2, 1001), 0
while True:
    batch = [(key, Row(number + n + 1, 0, 11, float(number + n + 1))) for n in range(700)]
    store.write(batch, number)
    number += len(batch)
    print(number, flush=True)
    store.tend(number, lambda _key: 1e6, 2**40)
"""


@pytest.mark.parametrize("lines", [2, 3, 5, 9])
def test_what_was_told_as_stored_is_there_after_a_kill(tmp_path: Path, lines: int) -> None:
    """The process writes and compacts all the time; it is killed when it has told of so many batches."""
    path = tmp_path / HISTORY_FILE
    writer = subprocess.Popen([sys.executable, "-c", _WRITER, str(path)], stdout=subprocess.PIPE, text=True)
    assert writer.stdout is not None
    with writer, writer.stdout:
        told = 0
        for _ in range(lines):
            told = int(writer.stdout.readline())
        os.kill(writer.pid, signal.SIGKILL)
        rest = writer.stdout.read().split()
        told = max([told, *map(int, rest)])
    with contextlib.closing(SqliteHistory(path)) as store:
        found = store.series(KEY).between(EARLIEST, LATEST, 1_000_000)
    assert [row.time for row in found] == list(range(1, len(found) + 1))
    assert len(found) >= told
