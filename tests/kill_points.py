"""What a kill would leave of SQLite files, and how often the disk is synced: seen at the connections themselves.

A process that is killed leaves what the kernel has of its files. So a copy of the folder that is made before a
statement is what a kill at that moment leaves, without a process for each.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest


@contextmanager
def _connections(noted: Callable[[sqlite3.Connection, str, bool], None]) -> Generator[None]:
    """Tell of each statement, before it is done and after it, also of `close`."""

    class Noted(sqlite3.Connection):
        def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
            noted(self, sql, True)
            cursor = super().execute(sql, *values)
            noted(self, sql, False)
            return cursor

        def close(self) -> None:
            noted(self, "close", True)
            super().close()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sqlite3, "connect", partial(sqlite3.connect, factory=Noted))
        yield


class KillPoints:
    """Copies of a folder as a kill would leave it, one before each statement of files that are opened meanwhile.

    Where nothing has changed since the last one, none is made.
    """

    def __init__(self, folder: Path, copies: Path) -> None:
        self._folder, self._copies = folder, copies
        self._last: tuple[dict[Path, bytes], Any] | None = None
        self.made: list[tuple[Path, Any]] = []
        """Each with what `state` said then."""
        self.state: Callable[[], Any] = lambda: None
        """What else there is at a moment."""

    def noted(self, _connection: sqlite3.Connection, _sql: str, is_before: bool) -> None:
        if is_before:
            self.copy()

    def copy(self) -> None:
        now = {path: path.read_bytes() for path in self._folder.rglob("*") if path.is_file()}, self.state()
        if now != self._last:
            self._last = now
            path = self._copies / f"killed-{len(self.made):04}"
            shutil.copytree(self._folder, path)
            self.made.append((path, now[1]))


@contextmanager
def kill_points(folder: Path, copies: Path) -> Generator[KillPoints]:
    """The copies that are made while this lasts, and the last one at its end."""
    points = KillPoints(folder, copies)
    with _connections(points.noted):
        yield points
    points.copy()


class Syncs:
    """How often the log of a file was synced to the disk since `take` was called last."""

    def __init__(self) -> None:
        self._count = 0
        self.is_pending = False
        """Whether something was committed that no sync has followed."""
        self._is_full: dict[sqlite3.Connection, bool] = {}
        self._changes: dict[sqlite3.Connection, int] = {}

    def take(self) -> int:
        count, self._count = self._count, 0
        return count

    def noted(self, connection: sqlite3.Connection, sql: str, is_before: bool) -> None:
        if is_before:
            if not connection.in_transaction and sql != "close":
                self._changes[connection] = connection.total_changes
            return
        if sql.startswith("PRAGMA synchronous="):
            self._is_full[connection] = sql.endswith("FULL")
        is_over = not connection.in_transaction and connection.total_changes > self._changes[connection]
        is_full = self._is_full.get(connection, True)
        self._count += is_over and is_full
        self.is_pending = (is_over and not is_full) or (self.is_pending and not is_over)

    def synced(self, descriptor: int, sync: Callable[[int], None] = os.fdatasync) -> None:
        sync(descriptor)
        self._count += 1
        self.is_pending = False


@contextmanager
def counted_syncs() -> Generator[Syncs]:
    """Count the syncs of files that are opened meanwhile."""
    syncs = Syncs()
    with _connections(syncs.noted), pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fdatasync", syncs.synced)
        yield syncs
