from __future__ import annotations

import errno
import os
import sqlite3
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.kill_points import counted_syncs, kill_points
from ua_fleet.errors import StorageUnavailable
from ua_fleet.storage.database import APPLICATION_ID, Database

SCHEMA = ("CREATE TABLE things (name TEXT PRIMARY KEY, size INTEGER) STRICT",)


def opened(path: Path, version: int = 3) -> Database:
    return Database(path, version=version, schema=SCHEMA)


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    made = opened(tmp_path / "state" / "journal.db")
    yield made
    made.close()


def put(database: Database, name: str) -> int:
    return database.commit(("INSERT INTO things VALUES (?, ?)", (name, 1)))


def put_many(database: Database, count: int) -> None:
    for number in range(count):
        put(database, f"{number}" * 500)


def test_what_was_committed_is_there_when_the_file_is_opened_again(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    database = opened(path)
    assert put(database, "a") == 1
    database.commit(("INSERT INTO things VALUES ('b', 2)", ()), ("UPDATE things SET size = 3", ()))
    database.close()
    database.close()
    again = opened(path)
    assert again.read("SELECT name, size FROM things ORDER BY name") == [("a", 3), ("b", 3)]
    again.close()


def test_the_file_its_log_and_its_folder_are_the_owner_s(database: Database) -> None:
    put(database, "a")
    files = list(database.path.parent.iterdir())
    assert {file.name for file in files} >= {"journal.db", "journal.db-wal"}
    assert {stat.S_IMODE(file.stat().st_mode) for file in files} == {0o600}
    assert stat.S_IMODE(database.path.parent.stat().st_mode) == 0o700


def test_the_log_is_synced_at_each_commit(database: Database) -> None:
    assert database.read("PRAGMA synchronous") == [(2,)]
    assert database.read("PRAGMA journal_mode") == [("wal",)]


def test_all_statements_of_a_commit_are_done_or_none(database: Database) -> None:
    put(database, "a")
    with pytest.raises(StorageUnavailable, match="UNIQUE"):
        database.commit(("INSERT INTO things VALUES ('b', 1)", ()), ("INSERT INTO things VALUES ('a', 1)", ()))
    assert database.read("SELECT name FROM things") == [("a",)]
    assert put(database, "c") == 1


def test_a_file_in_use_is_told_with_the_remedy(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ua_fleet.storage.database._LOCK_WAIT_S", 0.0)
    with pytest.raises(StorageUnavailable, match=r"journal\.db is in use by another process; stop it, or give"):
        opened(database.path)
    put(database, "still ours")


def test_a_full_disk_is_told_and_takes_nothing_back(database: Database) -> None:
    put(database, "before")
    [(pages,)] = database.read("PRAGMA page_count")
    database.read(f"PRAGMA max_page_count={pages}")
    with pytest.raises(StorageUnavailable, match=r"journal\.db: the disk is full; free some space"):
        put_many(database, 1000)
    with pytest.raises(StorageUnavailable, match="the disk is full"):
        database.commit(("INSERT INTO things VALUES ('x', 1)", ()), ("INSERT INTO things VALUES (?, 1)", ("y" * 9000,)))
    assert database.read("SELECT count(*) FROM things WHERE name IN ('before', 'x')") == [(1,)]
    database.read(f"PRAGMA max_page_count={pages + 1000}")
    assert put(database, "after") == 1


@pytest.mark.parametrize("content", [b"no database at all " * 100, b"SQLite format 3\0" + b"\xff" * 4096])
def test_a_broken_file_is_told_with_the_remedy(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "journal.db"
    path.write_bytes(content)
    with pytest.raises(StorageUnavailable, match=r"is broken \(.*\); see what the robots are doing, then move"):
        opened(path)


def test_pages_that_were_overwritten_are_found(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    database = opened(path)
    for number in range(500):
        put(database, f"{number:0100}")
    database.close()
    content = bytearray(path.read_bytes())
    content[3 * 4096 : 5 * 4096] = bytes(2 * 4096)
    path.write_bytes(content)
    with pytest.raises(StorageUnavailable, match="is broken"):
        opened(path)


def test_the_file_of_another_version_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    opened(path, version=4).close()
    with pytest.raises(StorageUnavailable, match="has format 4, and this version of ua-fleet knows 5; go back"):
        opened(path, version=5)
    with pytest.raises(StorageUnavailable, match="has version 4, and this ua-fleet reads version 3; upgrade ua-fleet"):
        opened(path, version=3)
    opened(path, version=4).close()


def test_the_file_of_another_program_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    other = sqlite3.connect(path)
    other.execute("CREATE TABLE theirs (name)")
    other.close()
    with pytest.raises(StorageUnavailable, match="is another program's file"):
        opened(path)
    with sqlite3.connect(path) as other:
        assert other.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID
        assert other.execute("PRAGMA journal_mode").fetchone()[0] == "delete"
    other.close()


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "state").write_text("a file")
    with pytest.raises(StorageUnavailable, match="look at the rights of its folder") as caught:
        opened(tmp_path / "state" / "journal.db")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("code", "remedy"),
    [
        (errno.ENOSPC, "free some space"),
        (errno.EDQUOT, "free some space"),
        (errno.EIO, "look at the disk"),
        (errno.ENXIO, "look at the disk"),
        (errno.EACCES, "look at the rights of its folder"),
        (errno.EROFS, "look at the rights of its folder"),
    ],
)
def test_what_the_system_refuses_is_told_with_what_helps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, remedy: str
) -> None:
    def refused(*_: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr("ua_fleet.storage.database.make_private_folder", refused)
    with pytest.raises(StorageUnavailable) as caught:
        opened(tmp_path / "journal.db")
    assert str(caught.value).endswith(f"{os.strerror(code)}; {remedy}")


def test_commits_of_one_sync_are_synced_when_they_must_be_and_at_the_end(tmp_path: Path) -> None:
    with counted_syncs() as syncs:
        database = opened(tmp_path / "journal.db")
        syncs.take()
        with database.one_sync():
            put(database, "a")
            put(database, "b")
            assert (syncs.take(), syncs.is_pending) == (0, True)
            database.settle()
            assert (syncs.take(), syncs.is_pending) == (1, False)
            database.settle()
            with database.one_sync():
                put(database, "c")
            assert (syncs.take(), syncs.is_pending) == (0, True), "a part of the other"
        assert (syncs.take(), syncs.is_pending) == (1, False)
        with database.one_sync():
            pass
        database.settle()
        assert syncs.take() == 0
        put(database, "d")
        assert (syncs.take(), syncs.is_pending) == (1, False)
        assert database.read("PRAGMA synchronous") == [(2,)]
        database.close()


def test_each_commit_of_one_sync_outlives_a_kill(tmp_path: Path) -> None:
    (tmp_path / "state").mkdir()
    with kill_points(tmp_path / "state", tmp_path) as points:
        database = opened(tmp_path / "state" / "journal.db")
        with database.one_sync():
            put(database, "a")
            database.commit(("INSERT INTO things VALUES ('b', 1)", ()), ("INSERT INTO things VALUES ('c', 1)", ()))
            database.settle()
        database.close()
    found: list[int] = []
    for point, _ in points.made:
        again = opened(point / "journal.db")
        found += again.read("SELECT count(*) FROM things")[0]
        again.close()
    assert set(found) == {0, 1, 3}
    assert found == sorted(found)


def test_what_fails_within_one_sync_takes_nothing_back(database: Database) -> None:
    def put_twice() -> None:
        with database.one_sync():
            put(database, "a")
            put(database, "a")

    with pytest.raises(StorageUnavailable, match="UNIQUE"):
        put_twice()
    assert database.read("SELECT name FROM things") == [("a",)]
    assert database.read("PRAGMA synchronous") == [(2,)]
    assert put(database, "b") == 1


def test_after_a_sync_that_failed_nothing_is_said_to_be_on_the_disk(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_descriptor: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    said = r"journal\.db: the disk could not be synced \(Input/output error\); look at the disk, and start this process"

    def put_within() -> None:
        with database.one_sync():
            put(database, "a")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", broken)
        with pytest.raises(StorageUnavailable, match=said):
            put_within()
    with pytest.raises(StorageUnavailable, match=said):
        put(database, "b")
    with pytest.raises(StorageUnavailable, match=said):
        database.settle()


def put_long(database: Database, first: int, count: int) -> None:
    for number in range(first, first + count):
        put(database, f"{number:06}" * 100)


def names_in(path: Path) -> list[int]:
    database = Database(path, version=3, schema=SCHEMA, is_prompt=True)
    names = [int(name[:6]) for (name,) in database.read("SELECT name FROM things ORDER BY name")]
    database.close()
    return names


@pytest.fixture
def prompt(tmp_path: Path) -> Iterator[Database]:
    made = Database(tmp_path / "state" / "journal.db", version=3, schema=SCHEMA, is_prompt=True)
    yield made
    made.close()


def test_commits_that_are_waited_for_leave_the_log_as_long_as_it_is(prompt: Database) -> None:
    log = Path(f"{prompt.path}-wal")
    length, size = log.stat().st_size, prompt.path.stat().st_size
    blocks = log.stat().st_blocks * 512
    assert blocks >= length > 0, "written, and not only reserved"
    put_long(prompt, 0, 1500)
    assert prompt.path.stat().st_size > size, "the log has begun anew meanwhile"
    assert (log.stat().st_size, log.stat().st_blocks * 512) == (length, blocks)
    prompt.close()
    assert names_in(prompt.path) == list(range(1500))


def test_the_log_grows_after_a_backup_and_has_its_length_again_after_a_start(prompt: Database) -> None:
    log = Path(f"{prompt.path}-wal")
    length = log.stat().st_size
    prompt.hold()
    assert log.stat().st_size == 0
    put_long(prompt, 0, 3)
    prompt.release()
    put_long(prompt, 3, 3)
    assert log.stat().st_size < length, "who releases it works on, and waits for nothing"
    prompt.close()
    again = Database(prompt.path, version=3, schema=SCHEMA, is_prompt=True)
    assert log.stat().st_size == length
    put_long(again, 6, 3)
    again.close()
    assert names_in(prompt.path) == list(range(9))


@pytest.mark.parametrize("count", [1, 5, 200])
def test_a_kill_and_a_power_cut_leave_the_first_commits_without_a_gap(
    prompt: Database, tmp_path: Path, count: int
) -> None:
    put_long(prompt, 0, count)
    pairs = (prompt.path.read_bytes(), Path(f"{prompt.path}-wal").read_bytes())
    for lost in (0, 1, 4096, 3 * 4120 + 7):
        folder = tmp_path / f"cut-{lost}"
        folder.mkdir()
        content, log = pairs
        end = len(log.rstrip(b"\0")) - lost
        (folder / "journal.db").write_bytes(content)
        (folder / "journal.db-wal").write_bytes(log[:end] + bytes(len(log) - end))
        found = names_in(folder / "journal.db")
        assert found == list(range(len(found)))
        assert len(found) == count if lost == 0 else len(found) < count


@pytest.mark.parametrize("name", ["pwrite", "fdatasync"])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
def test_a_disk_without_room_for_the_log_s_length_keeps_nobody_from_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, code: int
) -> None:
    def full(*_: object) -> int:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, name, full)
    database = Database(tmp_path / "journal.db", version=3, schema=SCHEMA, is_prompt=True)
    put_long(database, 0, 10)
    database.close()
    assert names_in(database.path) == list(range(10))


def test_a_disk_that_cannot_be_synced_is_told_of_at_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fdatasync", broken)
    with pytest.raises(StorageUnavailable, match="Input/output error; look at the disk"):
        Database(tmp_path / "journal.db", version=3, schema=SCHEMA, is_prompt=True)


def test_the_last_of_a_disk_is_for_what_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = os.statvfs(tmp_path)

    def nearly_full(_log: int) -> os.statvfs_result:
        return os.statvfs_result([*there[:4], 20_000_000 // there.f_frsize, *there[5:]])

    monkeypatch.setattr(os, "fstatvfs", nearly_full)
    database = Database(tmp_path / "journal.db", version=3, schema=SCHEMA, is_prompt=True)
    assert Path(f"{database.path}-wal").stat().st_size < 1_000_000
    put_long(database, 0, 10)
    database.close()
    assert names_in(database.path) == list(range(10))
