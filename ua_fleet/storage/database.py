"""One SQLite file of one process: its rights, its schema, and what can be wrong with it, said with the remedy.

A file is used by one process at a time: it stays locked until it is closed or the process ends, whichever way. What
`Database.commit` returned from is on the disk (WAL with synchronous=FULL: the log is synced at each commit).

The log of a file whose commits are waited for (`is_prompt`) has its length from the beginning: a sync of one that has
grown writes what the file system records of it, too. The zeros behind the last commit are none to SQLite, since no
frame of a log is of page 0.

Within `one_sync` a commit is whole or not there as ever, and outlives a kill of the process; the disk is synced once,
by `settle`, before anything of it leaves the process, and at the end. After a power cut the first commits are there,
without a gap.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
import threading
import weakref
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any, Final

from ua_fleet.errors import UPGRADE, StorageUnavailable, newer_version
from ua_fleet.storage.files import make_private_folder, sync_folder, unfinished_restore

__all__ = ["Database", "Run", "Statement", "copy_unused", "hold_own", "release_own", "version_of", "what_is_broken"]

APPLICATION_ID: Final = 0x7561_666A
"""`uafj`: tells our files from other SQLite files."""
Statement = tuple[str, Sequence[Any]]
"""A statement of SQL, with its values."""
Run = Callable[[str, Sequence[Any]], object]
"""Does a statement, within a transaction."""
_CHECKPOINT_PAGES: Final = 1_000
"""Of the log, as SQLite has it: so many are written into the file at once, and the log begins anew."""
_LOG_BYTES: Final = 32 + (_CHECKPOINT_PAGES + 64) * (24 + 4_096)
"""Of a log with so many pages, each with its head, and with those of the commit that passes them."""
_FREE_LOGS: Final = 8
"""So many times as much as a log has to be free on the disk for it to get its length at once."""
_LOCK_WAIT_S: Final = 1.0
"""How long the end of a process that still holds the file is waited for."""
_NO_ROOM: Final = (errno.ENOSPC, errno.EDQUOT)
_FAULTY: Final = (errno.EIO, errno.ENXIO, errno.ENODEV)
_FULL: Final = (sqlite3.SQLITE_FULL,)
_LOCKED: Final = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)
_BROKEN: Final = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_READ_ONLY: Final = (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_AUTH)


class Database:
    """An open SQLite file. Every method raises StorageUnavailable where the file or the disk does not do its part."""

    def __init__(
        self,
        path: Path,
        *,
        version: int,
        schema: Sequence[str],
        additions: Sequence[str] = (),
        fill: Callable[[Run], None] = lambda run: None,
        settings: Sequence[str] = (),
        is_checked: bool = True,
        is_prompt: bool = False,
    ) -> None:
        """Open a file, or make it with its folder; only its owner may read both.

        Args:
            path: the file.
            version: of the schema.
            schema: statements that make an empty file one of this version.
            additions: statements that are done at each opening: what files of this version may not have yet.
            fill: puts in what an empty file has from the beginning; that and the schema are one commit.
            settings: statements that are done before all others.
            is_checked: whether the whole file is looked at when it is opened, which takes seconds for a large one.
            is_prompt: whether somebody waits for commits: for 4 MB of the disk each takes about half the time.
        """
        if problem := unfinished_restore(path.parent):
            raise StorageUnavailable(problem)
        self.path = path
        self._is_prompt = is_prompt
        self._shares_sync = False
        self._is_unsynced = False
        """Whether something was committed that the next `settle` has to sync."""
        self._failed_sync = ""
        """Why the disk could not be synced. Then nobody knows what of the log is on it, and it stays so."""
        with _errors(self.path):
            make_private_folder(path.parent)
            # SQLite gives the log the rights that the file has.
            os.close(os.open(path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600))
            path.chmod(0o600)
            self._connection = sqlite3.connect(path, timeout=_LOCK_WAIT_S, isolation_level=None)
        try:
            with _errors(self.path):
                for setting in settings:
                    self._connection.execute(setting)
                self._prepare(version, schema, fill, is_checked=is_checked)
                for statement in additions:
                    self._connection.execute(statement)
                self._lengthen_log()
        except BaseException:
            self._connection.close()
            raise
        _own.databases.add(self)

    def read(self, statement: str, values: Sequence[Any] = ()) -> list[Any]:
        """All rows of a query."""
        with _errors(self.path):
            return self._connection.execute(statement, values).fetchall()

    def rows(self, statement: str, values: Sequence[Any] = ()) -> Generator[Sequence[Any]]:
        """The rows of a query one by one, however many."""
        with _errors(self.path):
            yield from self._connection.execute(statement, values)

    def commit(self, *statements: Statement) -> int:
        """Do all of them or none; on the disk when it returns. The number of rows that the last one changed."""
        self._check_sync()
        changed = 0
        with _errors(self.path):
            if len(statements) == 1:
                changed = self._connection.execute(*statements[0]).rowcount
            else:
                with self._transaction():
                    for statement, values in statements:
                        changed = self._connection.execute(statement, values).rowcount
        self._is_unsynced = self._shares_sync
        return changed

    @contextlib.contextmanager
    def one_sync(self) -> Generator[None]:
        """Have all that is committed within synced once: at the first `settle` after it, and at the end.

        Nothing of it may leave the process before: who sends anything calls `settle` first. Within another one it is a
        part of that.
        """
        if self._shares_sync:
            yield
            return
        with _errors(self.path):
            self._connection.execute("PRAGMA synchronous=NORMAL")
        self._shares_sync = True
        try:
            yield
        finally:
            self._shares_sync = False
            with _errors(self.path):
                self._connection.execute("PRAGMA synchronous=FULL")
            self.settle()

    def settle(self) -> None:
        """Have all that was committed on the disk when this returns."""
        self._check_sync()
        if not self._is_unsynced:
            return
        try:
            # No lock is on the log, so that closing it frees none.
            log = os.open(f"{self.path}-wal", os.O_RDWR | os.O_CLOEXEC)
            try:
                os.fdatasync(log)
            finally:
                os.close(log)
        except OSError as error:
            self._failed_sync = error.strerror or str(error)
            self._check_sync()
        self._is_unsynced = False

    def _check_sync(self) -> None:
        """After a sync that failed, the kernel may say of the next one that all is well: what it lost is lost."""
        if self._failed_sync:
            raise StorageUnavailable(
                f"{self.path}: the disk could not be synced ({self._failed_sync}); look at the disk, and start this"
                f" process again"
            )

    def close(self) -> None:
        """Give the file free. Safe to call twice."""
        self._connection.close()
        _own.databases.discard(self)

    def hold(self) -> None:
        """Leave the file as it is now, with all that was committed, until `release`; commits go to the log alone.

        Another process may copy it meanwhile. This one must not even open it: closing it would free SQLite's lock.
        """
        with _errors(self.path):
            self._connection.execute("PRAGMA wal_autocheckpoint=0")
            try:
                [is_busy, *_] = self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
                if is_busy:
                    raise StorageUnavailable(f"{self.path} is being read; make the backup again")
            except BaseException:
                self.release()
                raise

    def release(self) -> None:
        """Let the log be written into the file again, and grow to its length: to write that at once takes a while."""
        with _errors(self.path):
            self._connection.execute(f"PRAGMA wal_autocheckpoint={_CHECKPOINT_PAGES}")

    def _lengthen_log(self) -> None:
        """Give the log its length, where it is shorter. Only while the file is locked: others would be at its end."""
        if not self._is_prompt:
            return
        log = os.open(f"{self.path}-wal", os.O_RDWR | os.O_CLOEXEC)
        try:
            length, disk = os.fstat(log).st_size, os.fstatvfs(log)
            if disk.f_bavail * disk.f_frsize < _FREE_LOGS * _LOG_BYTES:
                return  # what there is of the disk is for what is recorded
            # Written, since space that is only reserved is one more record of the file system when it is used.
            os.pwrite(log, bytes(max(0, _LOG_BYTES - length)), length)
            os.fdatasync(log)
        except OSError as error:
            if error.errno not in _NO_ROOM:
                raise
        finally:
            os.close(log)

    def _prepare(self, version: int, schema: Sequence[str], fill: Callable[[Run], None], *, is_checked: bool) -> None:
        run = self._connection.execute
        run("PRAGMA locking_mode=EXCLUSIVE")
        is_new = run("SELECT count(*) FROM sqlite_master").fetchone()[0] == 0
        if not is_new:
            self._check_kind(version)
        run("PRAGMA journal_mode=WAL")
        run("PRAGMA synchronous=FULL")
        with self._transaction():  # takes the lock that is then held
            if is_new:
                for statement in schema:
                    run(statement)
                fill(run)
                run(f"PRAGMA application_id={APPLICATION_ID}")
                run(f"PRAGMA user_version={version}")
        complaint = run("PRAGMA quick_check(1)").fetchone()[0] if is_checked else "ok"
        if complaint != "ok":
            raise sqlite3.DatabaseError(str(complaint))
        if is_new:
            sync_folder(self.path.parent)

    def _check_kind(self, version: int) -> None:
        [(kind,)], [(found,)] = self.read("PRAGMA application_id"), self.read("PRAGMA user_version")
        if kind != APPLICATION_ID:
            raise StorageUnavailable(f"{self.path} is another program's file; name another state_dir, or move it away")
        if newer := newer_version(found, version):
            raise StorageUnavailable(f"{self.path} {newer}; {UPGRADE}")
        if found != version:
            raise StorageUnavailable(
                f"{self.path} has format {found}, and this version of ua-fleet knows {version}; go back to the version"
                f" that wrote it, or move the file away once no execution is open"
            )

    @contextlib.contextmanager
    def _transaction(self) -> Generator[None]:
        self._connection.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._connection.execute("COMMIT")
        except BaseException:
            if self._connection.in_transaction:  # an error that left nothing to take back has ended it already
                self._connection.execute("ROLLBACK")
            raise


class _Own(threading.local):
    """The open files of the thread that asks. A connection is used by the thread that made it."""

    def __init__(self) -> None:
        self.databases: weakref.WeakSet[Database] = weakref.WeakSet()


_own = _Own()


def hold_own() -> list[Path]:
    """Hold all files that this thread has open; their paths. Raises StorageUnavailable, and then holds none."""
    held: list[Path] = []
    try:
        for database in list(_own.databases):
            database.hold()
            held.append(database.path)
    except BaseException:
        release_own()
        raise
    return held


def release_own() -> None:
    """Release all files that this thread has open. One that cannot be is released by the next start."""
    for database in list(_own.databases):
        with contextlib.suppress(StorageUnavailable):
            database.release()


def copy_unused(path: Path, target: Path) -> None:
    """Copy a file that no process has open, with what the log of a process that was killed has.

    Args:
        path: of the file.
        target: of the copy, which is not there yet.

    Raises:
        StorageUnavailable: a process has it open, or it cannot be read.
    """
    with (
        _errors(path),
        contextlib.closing(sqlite3.connect(path, timeout=_LOCK_WAIT_S, isolation_level=None)) as source,
        contextlib.closing(sqlite3.connect(target)) as copy,
    ):
        source.execute("PRAGMA locking_mode=EXCLUSIVE")
        source.execute("BEGIN IMMEDIATE")
        source.execute("COMMIT")  # the lock stays
        source.backup(copy)


def what_is_broken(path: Path) -> str:
    """What SQLite finds wrong within a whole file that nobody else uses; empty where there is nothing."""
    try:
        with contextlib.closing(sqlite3.connect(path, timeout=_LOCK_WAIT_S)) as connection:
            found = str(connection.execute("PRAGMA integrity_check(1)").fetchone()[0])
    except sqlite3.Error as error:
        found = str(error)
    return "" if found == "ok" else " ".join(found.split())


def version_of(path: Path) -> int:
    """The version of a file; 0 where there is none, or one of another program.

    Raises:
        StorageUnavailable: it cannot be read.
    """
    if not path.exists():
        return 0
    with _errors(path), contextlib.closing(sqlite3.connect(path, timeout=_LOCK_WAIT_S)) as connection:
        kind, version = [
            connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version")
        ]
    return int(version) if kind == APPLICATION_ID else 0


@contextlib.contextmanager
def _errors(path: Path) -> Generator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise StorageUnavailable(_said(path, error)) from error
    except OSError as error:
        reason = error.strerror or str(error)
        remedy = "look at the rights of its folder"
        if error.errno in _NO_ROOM:
            remedy = "free some space"
        elif error.errno in _FAULTY:
            remedy = "look at the disk"
        raise StorageUnavailable(f"{path}: {reason}; {remedy}") from error


def _said(path: Path, error: sqlite3.Error) -> str:
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF
    reason = " ".join(str(error).split())
    if code in _FULL:
        return f"{path}: the disk is full; free some space"
    if code in _LOCKED:
        return f"{path} is in use by another process; stop it, or give this one a state_dir of its own"
    if code in _BROKEN:
        return (
            f"{path} is broken ({reason}); see what the robots are doing, then move the file away: what it"
            f" recorded is no longer known"
        )
    if code in _READ_ONLY:
        return f"{path} cannot be written ({reason}); look at the rights of its folder"
    return f"{path}: {reason}; look at the disk"
