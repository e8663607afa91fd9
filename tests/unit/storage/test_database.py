from __future__ import annotations

import sqlite3
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

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
