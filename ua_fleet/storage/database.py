"""One SQLite file of one process: its rights, its schema, and what can be wrong with it, said with the remedy.

A file is used by one process at a time: it stays locked until it is closed or the process ends, whichever way. What
`Database.commit` returned from is on the disk (WAL with synchronous=FULL: the log is synced at each commit).
"""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any, Final

from ua_fleet.errors import UPGRADE, StorageUnavailable, newer_version
from ua_fleet.storage.files import make_private_folder

__all__ = ["Database"]

APPLICATION_ID: Final = 0x7561_666A
"""`uafj`: tells our files from other SQLite files."""
_LOCK_WAIT_S: Final = 1.0
"""How long the end of a process that still holds the file is waited for."""
_FULL: Final = (sqlite3.SQLITE_FULL,)
_LOCKED: Final = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)
_BROKEN: Final = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_READ_ONLY: Final = (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_AUTH)


class Database:
    """An open SQLite file. Every method raises StorageUnavailable where the file or the disk does not do its part."""

    def __init__(self, path: Path, *, version: int, schema: Sequence[str]) -> None:
        """Open a file, or make it with its folder; only its owner may read both.

        Args:
            path: the file.
            version: of the schema.
            schema: statements that make an empty file one of this version.
        """
        self.path = path
        with self._errors():
            make_private_folder(path.parent)
            # SQLite gives the log the rights that the file has.
            os.close(os.open(path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600))
            path.chmod(0o600)
            self._connection = sqlite3.connect(path, timeout=_LOCK_WAIT_S, isolation_level=None)
        try:
            with self._errors():
                self._prepare(version, schema)
        except BaseException:
            self._connection.close()
            raise

    def read(self, statement: str, values: Sequence[Any] = ()) -> list[Any]:
        """All rows of a query."""
        with self._errors():
            return self._connection.execute(statement, values).fetchall()

    def commit(self, *statements: tuple[str, Sequence[Any]]) -> int:
        """Do all of them or none; on the disk when it returns. The number of rows that the last one changed."""
        with self._errors():
            if len(statements) == 1:
                return self._connection.execute(*statements[0]).rowcount
            changed = 0
            with self._transaction():
                for statement, values in statements:
                    changed = self._connection.execute(statement, values).rowcount
            return changed

    def close(self) -> None:
        """Give the file free. Safe to call twice."""
        self._connection.close()

    def _prepare(self, version: int, schema: Sequence[str]) -> None:
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
                run(f"PRAGMA application_id={APPLICATION_ID}")
                run(f"PRAGMA user_version={version}")
        complaint = run("PRAGMA quick_check(1)").fetchone()[0]
        if complaint != "ok":
            raise sqlite3.DatabaseError(str(complaint))

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

    @contextlib.contextmanager
    def _errors(self) -> Generator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise StorageUnavailable(self._said(error)) from error
        except OSError as error:
            reason = error.strerror or str(error)
            remedy = "free some space" if error.errno == errno.ENOSPC else "look at the rights of its folder"
            raise StorageUnavailable(f"{self.path}: {reason}; {remedy}") from error

    def _said(self, error: sqlite3.Error) -> str:
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF
        reason = " ".join(str(error).split())
        if code in _FULL:
            return f"{self.path}: the disk is full; free some space"
        if code in _LOCKED:
            return f"{self.path} is in use by another process; stop it, or give this one a state_dir of its own"
        if code in _BROKEN:
            return (
                f"{self.path} is broken ({reason}); see what the robots are doing, then move the file away: what it"
                f" recorded is no longer known"
            )
        if code in _READ_ONLY:
            return f"{self.path} cannot be written ({reason}); look at the rights of its folder"
        return f"{self.path}: {reason}; look at the disk"
