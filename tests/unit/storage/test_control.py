"""A process that holds its databases still while another one copies them."""

from __future__ import annotations

import asyncio
import sqlite3
import stat
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from ua_fleet.errors import StorageUnavailable
from ua_fleet.storage.control import held_by, state_control
from ua_fleet.storage.database import Database, copy_unused

SCHEMA = ("CREATE TABLE kept (number INTEGER PRIMARY KEY, text TEXT)",)


def opened(path: Path) -> Database:
    return Database(path, version=1, schema=SCHEMA)


def add(database: Database, number: int) -> None:
    database.commit(("INSERT INTO kept VALUES (?, ?)", (number, "x" * 3_000)))


def numbers(path: Path) -> list[int]:
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        return [number for (number,) in connection.execute("SELECT number FROM kept ORDER BY number")]


def copied(source: Path, target: Path) -> Path:
    """As another process does it; here it would free SQLite's lock, which no test needs."""
    target.write_bytes(source.read_bytes())
    return target


def within(folder: Path, files: list[Path]) -> list[Path]:
    """Without files that other tests of this process have left open."""
    return [file for file in files if file.is_relative_to(folder)]


async def test_a_file_stands_still_while_it_is_held_and_commits_go_on(tmp_path: Path) -> None:
    with closing(opened(tmp_path / "a.db")) as database:
        add(database, 1)
        async with state_control(tmp_path, "server"):
            assert stat.S_IMODE((tmp_path / "server.control").stat().st_mode) == 0o600

            def work() -> bytes:
                with held_by(tmp_path / "server.control") as process:
                    assert process is not None
                    assert within(tmp_path, process.files) == [tmp_path / "a.db"]
                    before = (tmp_path / "a.db").read_bytes()
                    asyncio.run_coroutine_threadsafe(commits(), loop).result(30)
                    assert (tmp_path / "a.db").read_bytes() == before
                    process.still()
                    return before

            async def commits() -> None:
                for number in range(2, 2_000):  # 6 MB: beyond where the log is written into the file
                    add(database, number)

            loop = asyncio.get_running_loop()
            with database.one_sync():
                before = await asyncio.to_thread(work)
            (tmp_path / "copy.db").write_bytes(before)
            assert numbers(tmp_path / "copy.db") == [1]
            for number in range(2_000, 2_010):
                add(database, number)
            assert (tmp_path / "a.db").stat().st_size > 6_000_000, "it is released"
        assert not (tmp_path / "server.control").exists()
    assert numbers(tmp_path / "a.db") == list(range(1, 2_010))


async def test_databases_of_other_threads_are_held_too(tmp_path: Path) -> None:
    with ThreadPoolExecutor(1) as executor:
        loop = asyncio.get_running_loop()

        async def in_thread(work: Callable[[], Any]) -> Any:
            return await loop.run_in_executor(executor, work)

        database: Database = await in_thread(lambda: opened(tmp_path / "b.db"))
        async with state_control(tmp_path, "server", [in_thread]):

            def held() -> list[Path]:
                with held_by(tmp_path / "server.control") as process:
                    assert process is not None
                    return within(tmp_path, process.files)

            assert await asyncio.to_thread(held) == [tmp_path / "b.db"]
        await in_thread(database.close)


async def test_one_backup_at_a_time_and_one_that_is_gone_holds_nothing(tmp_path: Path) -> None:
    place = tmp_path / "server.control"
    with closing(opened(tmp_path / "a.db")) as database:
        async with state_control(tmp_path, "server"):

            def first() -> None:
                with held_by(place) as process:
                    assert process is not None
                    with pytest.raises(StorageUnavailable, match="another backup is being made"):
                        held_by(place).__enter__()
                # gone without a word, as one that was killed

            await asyncio.to_thread(first)

            def again() -> bool:
                try:
                    with held_by(place) as process:
                        return process is not None
                except StorageUnavailable:
                    return False

            while not await asyncio.to_thread(again):
                await asyncio.sleep(0.01)
            add(database, 1)


async def test_files_that_were_not_held_so_long_are_no_backup(tmp_path: Path) -> None:
    place = tmp_path / "server.control"
    with closing(opened(tmp_path / "a.db")):
        async with state_control(tmp_path, "server", longest_s=0.2):

            def too_long() -> None:
                with held_by(place) as process:
                    assert process is not None
                    assert process._lines.readline() == b"", "it ends by itself"  # pyright: ignore[reportPrivateUsage]
                    process.still()

            with pytest.raises(StorageUnavailable, match="make the backup again"):
                await asyncio.to_thread(too_long)


def test_nobody_is_there(tmp_path: Path) -> None:
    with held_by(tmp_path / "server.control") as process:
        assert process is None


async def test_a_socket_that_a_kill_has_left_is_no_process_and_in_nobodys_way(tmp_path: Path) -> None:
    async with state_control(tmp_path, "server"):
        (tmp_path / "server.control").rename(tmp_path / "left.control")
    with held_by(tmp_path / "left.control") as process:
        assert process is None
    (tmp_path / "left.control").rename(tmp_path / "server.control")
    async with state_control(tmp_path, "server"):
        assert (tmp_path / "server.control").is_socket()


def test_what_nobody_has_open_is_copied_with_its_log(tmp_path: Path) -> None:
    database = opened(tmp_path / "a.db")
    add(database, 1)
    folder = tmp_path / "killed"
    folder.mkdir()
    for path in tmp_path.glob("a.db*"):  # as a kill leaves them
        copied(path, folder / path.name)
    assert (folder / "a.db-wal").exists()
    database.close()
    copy_unused(folder / "a.db", tmp_path / "copy.db")
    assert numbers(tmp_path / "copy.db") == [1]


def test_what_a_process_has_open_is_not_copied(tmp_path: Path) -> None:
    with closing(opened(tmp_path / "a.db")), pytest.raises(StorageUnavailable, match="in use by another process"):
        copy_unused(tmp_path / "a.db", tmp_path / "copy.db")
