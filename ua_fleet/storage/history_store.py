"""History in one SQLite file: rows first, then blocks of a thousand.

Rows are written as they come, a batch in one commit. Once a node has two thousand of them, the older half becomes a
block, which takes a fifth of the space and is read in one piece. Both are in one order: each row is later than the
blocks of its node.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from ua_fleet.errors import StorageUnavailable
from ua_fleet.history.blocks import decode_value, encode_block, encode_value
from ua_fleet.history.recorder import Kept
from ua_fleet.history.rows import EARLIEST, LATEST, MOST_READ_BYTES, Rows
from ua_fleet.history.store import BOUNDED, BOUNDED_PART, cut_of, node_of, node_text, over_limit_text
from ua_fleet.storage.database import Database, Run, Statement
from ua_fleet.storage.decoded_blocks import BLOCK_BYTES, BLOCK_ROWS, BROKEN, OVERDUE, ROUND, DecodedBlocks, uncollected
from ua_fleet.values import TICKS_PER_SECOND, NodeId

__all__ = ["HISTORY_FILE", "SqliteHistory"]

HISTORY_FILE: Final = "history.db"
VERSION: Final = 1
_SLICE: Final = 100
"""Nodes whose age is looked at in one piece of work."""
_DAY: Final = 86_400 * TICKS_PER_SECOND
_FREED_PAGES: Final = 2_000
"""Pages that are given back to the disk at once: 8 MB."""
_MOST_PASSES: Final = 400
"""Of removing what is too much: after so many there is nothing left."""
_SCHEMA: Final = (
    "CREATE TABLE meta (name TEXT PRIMARY KEY, value BLOB) WITHOUT ROWID",
    "CREATE TABLE node (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE)",
    "CREATE TABLE row (node INTEGER, time INTEGER, status INTEGER, value BLOB, PRIMARY KEY (node, time)) WITHOUT ROWID",
    "CREATE TABLE block (node INTEGER, first INTEGER, last INTEGER, data BLOB, PRIMARY KEY (node, first))",
    "CREATE INDEX block_by_age ON block (last)",
)
_INSERT_ROW: Final = "INSERT INTO row (node, time, status, value) VALUES (?, ?, ?, ?)"
_ROWS: Final = (
    "SELECT time, status, value FROM row WHERE node = ? AND time BETWEEN ? AND ? ORDER BY time LIMIT ?",
    "SELECT time, status, value FROM row WHERE node = ? AND time BETWEEN ? AND ? ORDER BY time DESC LIMIT ?",
)
_BLOCKS: Final = (
    """SELECT first FROM block WHERE node = ?1 AND first <= ?2 AND last >= ?3
        AND first >= ifnull((SELECT max(first) FROM block WHERE node = ?1 AND first <= ?3), 0) ORDER BY first""",
    """SELECT first FROM block WHERE node = ?1 AND first <= ?2 AND last >= ?3
        AND first >= ifnull((SELECT max(first) FROM block WHERE node = ?1 AND first <= ?3), 0) ORDER BY first DESC""",
)
"""Forward and backward. Blocks of a node follow each other, so that those before the last one that begins at or before
the first time need not be looked at, however many."""
_SIZES: Final = (
    "SELECT time, length(value) FROM row WHERE node = ? ORDER BY time DESC",
    "SELECT last, length(data) FROM block WHERE node = ? ORDER BY first DESC",
)
"""Of a node's rows and blocks, the newest first."""
_LAST_BLOCKS: Final = """SELECT node, last FROM block
    WHERE (node, first) IN (SELECT node, max(first) FROM block GROUP BY node)"""
"""Of each node, by the index: to read a page for each block of a large file takes minutes of a slow disk."""
_OLDEST_ROW: Final = "SELECT min(time) FROM (SELECT (SELECT min(time) FROM row WHERE node = id) AS time FROM node)"
"""Of each node, by the index."""
_REMOVE_BLOCKS: Final = "DELETE FROM block WHERE node = ?1 AND first < ?2 AND last < ?2"
"""Of a node's blocks those alone are looked at that begin before the time."""
_ALIVE: Final = "INSERT OR REPLACE INTO meta (name, value) VALUES ('alive', ?)"


class SqliteHistory:
    """The default store; see `HistoryStore`."""

    def __init__(self, path: Path) -> None:
        """Open a file, or make it."""
        self.path = path
        self.over_limit = ""
        self._database = Database(
            path,
            version=VERSION,
            schema=_SCHEMA,
            fill=_fill,
            settings=("PRAGMA auto_vacuum=INCREMENTAL", "PRAGMA cache_size=-8000"),
            is_checked=False,  # a file of a gigabyte would be read for seconds
        )
        try:
            self._read_all()
        except BaseException:
            self._database.close()
            raise

    def _read_all(self) -> None:
        """What is kept in memory: the nodes, and for each its last time and the number of its rows."""
        meta: dict[str, bytes] = dict(self._database.read("SELECT name, value FROM meta"))
        self.secret = bytes(meta["secret"])
        self.stopped_at = int(meta.get("alive", 0))
        self._ids: dict[NodeId, int] = {
            node_of(name): number for number, name in self._database.read("SELECT id, name FROM node")
        }
        self._last: dict[int, int] = dict(self._database.read(_LAST_BLOCKS))
        self._counts: dict[int, int] = {}
        for node, count, last in self._database.read("SELECT node, count(*), max(time) FROM row GROUP BY node"):
            self._counts[node] = count
            self._last[node] = last
        self._decoded = DecodedBlocks()
        self._large: list[int] = [node for node, count in self._counts.items() if count >= 2 * BLOCK_ROWS]
        """Nodes with enough rows for a block."""
        self._aged: list[NodeId] = []
        """Nodes whose age is yet to be looked at in this round."""
        self._passes: int | None = None
        """Of removing what is too much: those that are left in this round; None where it has ended."""
        self._cut = 0
        self._uncut: list[int] = []
        """The time before which a pass removes, and the nodes from which it has not yet."""
        self._next_round = 0

    def last_times(self) -> dict[NodeId, int]:
        """The time of the last row of each node that has any."""
        return {key: self._last[number] for key, number in self._ids.items() if number in self._last}

    def write(self, batch: Sequence[Kept], now: int) -> None:
        """Store rows in one commit."""
        statements: list[Statement] = []
        ids, last, counts = dict[NodeId, int](), dict[int, int](), dict[int, int]()
        for key, row in batch:
            number = self._ids.get(key) or ids.get(key)
            if number is None:
                number = ids[key] = len(self._ids) + len(ids) + 1
                statements.append(("INSERT INTO node (id, name) VALUES (?, ?)", (number, node_text(key))))
            if row.time <= last.get(number, self._last.get(number, -1)):
                continue  # it is there: the commit was made, and only its answer was not
            last[number] = row.time
            counts[number] = counts.get(number, 0) + 1
            statements.append((_INSERT_ROW, (number, row.time, row.status, encode_value(row))))
        self._database.commit(*statements, (_ALIVE, (now,)))
        self._ids |= ids
        self._last |= last
        for number, count in counts.items():
            before = self._counts.get(number, 0)
            self._counts[number] = before + count
            if before < 2 * BLOCK_ROWS <= before + count:
                self._large.append(number)

    def series(self, key: NodeId) -> SqliteSeries:
        """The rows of a node."""
        return SqliteSeries(self, self._ids.get(key, 0))

    def used_bytes(self) -> int:
        """Bytes of the pages that hold something."""
        [(pages,)], [(free,)], [(size,)] = [
            self._database.read(f"PRAGMA {name}") for name in ("page_count", "freelist_count", "page_size")
        ]
        return int((pages - free) * size)

    def tend(self, now: int, days_of: Callable[[NodeId], float], most_bytes: int) -> bool:
        """Compact a node, or remove what is too old or too much of some."""
        if not self._next_round or now < self._next_round - ROUND:  # the clock was set back
            self._next_round = now
        if self._passes is not None:
            return self._remove_most(now, most_bytes, self._passes)
        if self._large and not (self._aged or now >= self._next_round + OVERDUE):
            number = self._large.pop()
            if self._has_many(number):
                self._compact(number)
            if self._has_many(number):
                self._large.append(number)
            return True
        if not self._aged:
            if now < self._next_round:
                return False
            self._next_round = now + ROUND
            self._aged = list(self._ids)
            # Once more, after the others, those whose compaction has failed; in between there was time for ages.
            waiting = set(self._large)
            failed = [number for number in self._counts if self._has_many(number) and number not in waiting]
            self._large = failed + self._large
            self._cut_bounded(most_bytes // BOUNDED_PART)
            return self._remove_most(now, most_bytes, _MOST_PASSES)
        some, self._aged = self._aged[:_SLICE], self._aged[_SLICE:]
        self._remove_old({self._ids[key]: now - int(days_of(key) * _DAY) for key in some})
        return bool(self._aged or self._large)

    def close(self) -> None:
        """Give the file free."""
        self._database.close()

    def _has_many(self, number: int) -> bool:
        """Whether a node has enough rows for a block."""
        return self._counts.get(number, 0) >= 2 * BLOCK_ROWS

    def _compact(self, number: int) -> None:
        """Make a block of the oldest rows of a node, in one commit."""
        rows = Rows(BLOCK_ROWS, BLOCK_BYTES)
        self._add_rows(rows, number, EARLIEST, LATEST, backward=False)
        self._database.commit(
            (
                "INSERT INTO block (node, first, last, data) VALUES (?, ?, ?, ?)",
                (number, rows[0].time, rows[-1].time, encode_block(rows)),
            ),
            ("DELETE FROM row WHERE node = ? AND time <= ?", (number, rows[-1].time)),
        )
        self._counts[number] -= len(rows)

    def _remove_old(self, before: dict[int, int]) -> None:
        statements: list[Statement] = []
        for number, time in before.items():
            statements.append((_REMOVE_BLOCKS, (number, time)))
            statements.append(("DELETE FROM row WHERE node = ? AND time < ?", (number, time)))
        self._database.commit(*statements)
        self._count_again(before)

    def _count_again(self, numbers: dict[int, int]) -> None:
        self._decoded.clear()
        for number in numbers:
            if self._counts.get(number):
                [(count,)] = self._database.read("SELECT count(*) FROM row WHERE node = ?", (number,))
                self._counts[number] = count

    def _cut_bounded(self, most_bytes: int) -> None:
        """Remove the oldest of the series that takes more than its part."""
        if (number := self._ids.get(BOUNDED)) is None:
            return
        sizes = (size for statement in _SIZES for size in self._database.read(statement, (number,)))
        if (cut := cut_of(sizes, most_bytes)) is not None:
            self._remove_old({number: cut + 1})

    def _remove_most(self, now: int, most_bytes: int, passes: int) -> bool:
        """Remove a twentieth of the time that is kept, of some nodes at once, and again while there is too much.

        Returns:
            Whether there is more to do now.
        """
        nodes = self._uncut
        self._passes, self._uncut = None, []  # where it fails, the next round begins anew, and others have their turn
        if not nodes and passes and self.used_bytes() > most_bytes and (oldest := self._oldest()) is not None:
            passes, nodes = passes - 1, list(self._ids.values())
            self._cut = oldest + max((now - oldest) // 20, TICKS_PER_SECOND)
        if nodes:
            self._remove_old(dict.fromkeys(nodes[:_SLICE], self._cut))
            self._passes, self._uncut = passes, nodes[_SLICE:]
            return True
        self.over_limit = over_limit_text(self.used_bytes(), most_bytes)
        self._database.read(f"PRAGMA incremental_vacuum({_FREED_PAGES})")
        return bool(self._aged or self._large)

    def _oldest(self) -> int | None:
        """The time of the oldest row or block. A block goes as a whole: one of a node that seldom changes must not hold
        up all others.
        """
        [(block,)] = self._database.read("SELECT min(last) FROM block")
        [(row,)] = self._database.read(_OLDEST_ROW)
        return min((int(time) for time in (block, row) if time is not None), default=None)

    def _add_rows(self, found: Rows, number: int, first: int, last: int, *, backward: bool) -> None:
        """Add those of a node that are in no block, one by one: each may have a megabyte."""
        rows = self._database.rows(_ROWS[backward], (number, first, last, found.room))
        try:
            found.take(decode_value(*row) for row in rows)
        except BROKEN as error:
            raise self._broken(error) from error

    def _add_block(self, found: Rows, key: tuple[int, int], first: int, last: int, *, backward: bool) -> None:
        """Add those of a block."""
        if key not in self._decoded:
            [(data,)] = self._database.read("SELECT data FROM block WHERE node = ? AND first = ?", key)
            try:
                self._decoded.add(key, data)
            except BROKEN as error:
                raise self._broken(error) from error
        self._decoded.put_into(found, key, first, last, backward=backward)

    def _broken(self, error: Exception) -> StorageUnavailable:
        return StorageUnavailable(f"{self.path} is broken ({error}); move the file away: a new one is made")

    def between(self, number: int, first: int, last: int, found: Rows, *, backward: bool) -> Rows:
        """Rows of a node, as `Series.between`, added to `found`."""
        if first > last or not found.room or not number:
            return found
        with uncollected():
            self._add(found, number, first, min(last, LATEST), backward=backward)
        return found

    def _add(self, found: Rows, number: int, first: int, last: int, *, backward: bool) -> None:
        if backward:
            self._add_rows(found, number, first, last, backward=True)
        if found.room:
            for (start,) in self._database.rows(_BLOCKS[backward], (number, last, first)):
                self._add_block(found, (number, start), first, last, backward=backward)
                if not found.room:
                    return
        if not backward:
            self._add_rows(found, number, first, last, backward=False)


class SqliteSeries:
    """The rows of one node."""

    def __init__(self, store: SqliteHistory, number: int) -> None:
        self._store, self._number = store, number

    def between(
        self, first: int, last: int, most: int, *, backward: bool = False, most_bytes: int = MOST_READ_BYTES
    ) -> Rows:
        """As the protocol says."""
        return self._store.between(self._number, first, last, Rows(most, most_bytes), backward=backward)


def _fill(run: Run) -> None:
    run("INSERT INTO meta (name, value) VALUES ('secret', ?)", (secrets.token_bytes(32),))
