"""History in PostgreSQL: rows first, then blocks of a thousand, both in native partitions by day.

Rows come by COPY, a batch in one commit. Once a node has two thousand of them, the older half becomes a block, which
takes a tenth of the space; a block never spans two days. Each row is later than the blocks of its node.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Sequence
from itertools import takewhile
from typing import Final

from ua_fleet.errors import UPGRADE, StorageUnavailable, newer_version
from ua_fleet.history.blocks import decode_value, encode_block, encode_value
from ua_fleet.history.recorder import Kept
from ua_fleet.history.rows import EARLIEST, LATEST, MOST_READ_BYTES, Rows
from ua_fleet.history.store import BOUNDED, BOUNDED_PART, cut_of, node_of, node_text, over_limit_text
from ua_fleet.storage.decoded_blocks import BLOCK_BYTES, BLOCK_ROWS, BROKEN, OVERDUE, ROUND, DecodedBlocks, uncollected
from ua_fleet.storage.postgres import TENDING_S, Connection, PostgresDatabase
from ua_fleet.storage.postgres_tables import (
    BLOCKS,
    CREATE_TABLES,
    DAY,
    PARTITIONS,
    PARTITIONS_OF,
    ROWS,
    SCHEMA,
    SET_META,
    SIZES,
    TABLES,
    add_day,
    used_bytes,
)
from ua_fleet.values import NodeId

__all__ = ["SCHEMA", "PostgresHistory"]

VERSION: Final = 1
_SLICE: Final = 100
"""Nodes whose age is looked at in one piece of work."""
_ROW_BYTES: Final = 150
"""Of a row that is in no block, with its index."""
_SPARE_BYTES: Final = 256_000
"""Of rows that are in blocks by now, or of blocks that were removed: less is not worth writing a partition anew."""
_BLOCK_BYTES: Final = 200
"""Of a block, beside its data."""
_LOOKED_AT: Final = 8
"""Partitions of blocks that are looked at in a round, one after the other: to count what is in them takes time."""
_COUNTS: Final = "SELECT node, count(*) FROM sample"
_BLOCKS_READ: Final = 8
_BLOCKS_BYTES: Final = 4 * BLOCK_BYTES
"""Of blocks that are read at once; one may have more."""
_TRIES: Final = 40
"""To come below the size that the store may have, in one round."""


class PostgresHistory:
    """The store for histories that are large, or used by other programs too; see `HistoryStore`."""

    def __init__(self, url: str, user: str, password: str | None) -> None:
        """Open the store of a database, or make it.

        Args:
            url: `postgresql://host:port/database`.
            user: there.
            password: of that user; None where PostgreSQL asks for none.
        """
        self._next_round = 0
        self.over_limit = ""
        self._tries: int | None = None
        """To remove what is too much: those that are left in this round; None where it has ended."""
        self._to_look_at: list[str] = []
        """Partitions whose blocks may have been removed in part."""
        self._aged: list[NodeId] = []
        """Nodes whose age is yet to be looked at in this round."""
        self._database = PostgresDatabase(url, user, password, self._prepare)

    @property
    def name(self) -> str:
        """Of the database, for messages."""
        return self._database.name

    async def _prepare(self, connection: Connection) -> None:
        """Make what is missing, and read what is kept in memory: another connection may have lost an answer."""
        async with connection.transaction():
            if await connection.fetchval("SELECT to_regnamespace($1) IS NULL", SCHEMA):
                await connection.execute(f"CREATE SCHEMA {SCHEMA}")
            await connection.execute(f"SET SESSION search_path TO {SCHEMA}")
            if await connection.fetchval("SELECT to_regclass($1) IS NULL", f"{SCHEMA}.meta"):
                for statement in CREATE_TABLES:
                    await connection.execute(statement)
                for name, value in (("version", str(VERSION).encode()), ("secret", secrets.token_bytes(32))):
                    await connection.execute(SET_META, name, value)
        meta = dict(await connection.fetch("SELECT name, value FROM meta"))
        found = int(meta["version"])
        if newer := newer_version(found, VERSION):
            raise StorageUnavailable(f"the history in schema {SCHEMA} of the database {newer}; {UPGRADE}")
        self.secret = bytes(meta["secret"])
        self.stopped_at = int(meta.get("alive", b"0"))
        await self._read_all(connection)

    async def _read_all(self, connection: Connection) -> None:
        self._ids: dict[NodeId, int] = {
            node_of(bytes(name).decode("utf-8", "surrogatepass")): number
            for number, name in await connection.fetch("SELECT id, name FROM node")
        }
        self._last: dict[int, int] = dict(await connection.fetch("SELECT node, max(last) FROM block GROUP BY node"))
        self._counts: dict[int, int] = {}
        for node, count, time in await connection.fetch("SELECT node, count(*), max(time) FROM sample GROUP BY node"):
            self._counts[node] = count
            self._last[node] = time
        await self._read_days(connection)
        self._decoded = DecodedBlocks()
        self._large = self._with_many()

    async def _read_days(self, connection: Connection) -> None:
        names = [str(name) for (name,) in await connection.fetch(PARTITIONS)]
        self._days = {int(name.removeprefix("sample_d")) for name in names if name != "sample_late"}
        """Those that have a partition, counted from the epoch of ticks."""

    def _with_many(self) -> list[int]:
        """Nodes with enough rows for a block."""
        return [number for number in self._counts if self._has_many(number)]

    def _has_many(self, number: int) -> bool:
        return self._counts.get(number, 0) >= 2 * BLOCK_ROWS

    def last_times(self) -> dict[NodeId, int]:
        """The time of the last row of each node that has any."""
        return {key: self._last[number] for key, number in self._ids.items() if number in self._last}

    def write(self, batch: Sequence[Kept], now: int) -> None:
        """Store rows in one commit."""
        self._database.run(lambda connection: self._write(connection, batch, now))

    async def _write(self, connection: Connection, batch: Sequence[Kept], now: int) -> None:
        ids, last, counts = dict[NodeId, int](), dict[int, int](), dict[int, int]()
        rows: list[tuple[int, int, int, bytes]] = []
        for key, row in batch:
            number = self._ids.get(key) or ids.get(key)
            if number is None:
                number = ids[key] = len(self._ids) + len(ids) + 1
            if row.time <= last.get(number, self._last.get(number, -1)):
                continue  # it is there: the commit was made, and only its answer was not
            last[number] = row.time
            counts[number] = counts.get(number, 0) + 1
            rows.append((number, row.time, row.status, encode_value(row)))
        today = now // DAY
        days = {time // DAY for _, time, _, _ in rows}.intersection(range(today - 1, today + 2)) - self._days
        async with connection.transaction():
            for day in days:
                await add_day(connection, day)
            if ids:
                nodes = [(number, node_text(key).encode("utf-8", "surrogatepass")) for key, number in ids.items()]
                await connection.copy_records_to_table("node", records=nodes, schema_name=SCHEMA)
            if rows:
                await connection.copy_records_to_table("sample", records=rows, schema_name=SCHEMA)
            await connection.execute(SET_META, "alive", str(now).encode())
        self._ids |= ids
        self._last |= last
        self._days |= days
        for number, count in counts.items():
            before = self._counts.get(number, 0)
            self._counts[number] = before + count
            if before < 2 * BLOCK_ROWS <= before + count:
                self._large.append(number)

    def series(self, key: NodeId) -> PostgresSeries:
        """The rows of a node."""
        return PostgresSeries(self, key)

    def used_bytes(self) -> int:
        """Bytes of all partitions with their indexes."""
        return self._database.run(used_bytes)

    def tend(self, now: int, days_of: Callable[[NodeId], float], most_bytes: int) -> bool:
        """Compact a node, or remove what is too old."""
        return self._database.run(lambda connection: self._tend(connection, now, days_of, most_bytes), TENDING_S)

    def close(self) -> None:
        """Give the database free."""
        self._database.close()

    async def _tend(
        self, connection: Connection, now: int, days_of: Callable[[NodeId], float], most_bytes: int
    ) -> bool:
        if not self._next_round or now < self._next_round - ROUND:  # the clock was set back
            self._next_round = now
        if self._tries is not None:
            return await self._remove_most(connection, now, most_bytes, self._tries)
        if self._large and not (self._aged or now >= self._next_round + OVERDUE):
            number = self._large.pop()
            if self._has_many(number):
                await self._compact(connection, number)
            if self._has_many(number):
                self._large.append(number)
            return True
        if not self._aged:
            if now < self._next_round:
                return False
            self._next_round = now + ROUND
            kept = {key: days_of(key) for key in self._ids}
            longest = max(kept.values(), default=0.0)
            self._aged = [key for key, days in kept.items() if days < longest]
            # Once more, after the others, those whose compaction has failed; in between there was time for ages.
            waiting = set(self._large)
            self._large = [number for number in self._with_many() if number not in waiting] + self._large
            if kept:
                await self._drop_old(connection, now - int(longest * DAY))
            await self._vacuum(connection, most_bytes)
            await self._cut_bounded(connection, most_bytes // BOUNDED_PART)
            return await self._remove_most(connection, now, most_bytes, _TRIES)
        some, self._aged = self._aged[:_SLICE], self._aged[_SLICE:]
        await self._remove_old(connection, {self._ids[key]: now - int(days_of(key) * DAY) for key in some})
        return bool(self._aged or self._large)

    async def _compact(self, connection: Connection, number: int) -> None:
        """Make a block of the oldest rows of a node, in one commit."""
        oldest = Rows(BLOCK_ROWS, BLOCK_BYTES)
        await self._add_rows(connection, oldest, number, EARLIEST, LATEST, backward=False)
        day = oldest[0].time // DAY
        rows = list(takewhile(lambda row: row.time // DAY == day, oldest))
        data = encode_block(rows)
        async with connection.transaction():
            await connection.execute(
                "INSERT INTO block VALUES ($1, $2, $3, $4)", number, rows[0].time, rows[-1].time, data
            )
            await connection.execute("DELETE FROM sample WHERE node = $1 AND time <= $2", number, rows[-1].time)
        self._counts[number] -= len(rows)

    async def _drop_old(self, connection: Connection, before: int) -> None:
        """Drop the days that are too old for all nodes."""
        old = [day for day in sorted(self._days) if (day + 1) * DAY <= before]
        for day in old:
            await self._drop_day(connection, day)
        for table, column in (("sample", "time"), ("block", "last")):
            await connection.execute(f"DELETE FROM {table}_late WHERE {column} < {before:d}")
        await self._count_again(connection)

    async def _drop_day(self, connection: Connection, day: int) -> None:
        """The oldest day, by far the quickest way to remove anything."""
        await connection.execute("; ".join(f"DROP TABLE {table}_d{day:d}" for table, _ in TABLES))
        self._days.discard(day)

    async def _remove_old(self, connection: Connection, before: dict[int, int]) -> None:
        """Remove the old rows of nodes that are kept for a shorter time than others."""
        numbers, times = list(before), list(before.values())
        for (table, by), column in zip(TABLES, ("time", "last"), strict=True):
            await connection.execute(
                f"DELETE FROM {table} USING unnest($1::integer[], $2::bigint[]) AS old (number, before)"
                # The constant leaves out the partitions of later days.
                f" WHERE node = number AND {column} < before AND {by} < {max(times):d}",
                numbers,
                times,
            )
        self._decoded.clear()
        left = dict(await connection.fetch(f"{_COUNTS} WHERE node = ANY($1::integer[]) GROUP BY node", numbers))
        self._counts |= {number: left.get(number, 0) for number in numbers}

    async def _count_again(self, connection: Connection) -> None:
        self._decoded.clear()
        self._counts = dict(await connection.fetch(f"{_COUNTS} GROUP BY node"))

    async def _vacuum(self, connection: Connection, most_bytes: int) -> None:
        """Write partitions anew that are large and nearly empty: of rows, since theirs are in blocks by now."""
        live = dict(await connection.fetch("SELECT tableoid::regclass::text, count(*) FROM sample GROUP BY 1"))
        for name in [f"sample_d{day}" for day in self._days] + ["sample_late"]:
            await self._rewrite(connection, name, _ROW_BYTES * live.get(name, 0))
        is_over = await used_bytes(connection) > most_bytes  # then all are, before anything is dropped
        if is_over or not self._to_look_at:
            self._to_look_at = [*(f"d{day}" for day in sorted(self._days)), "late"]
        most = len(self._to_look_at) if is_over else _LOOKED_AT
        looked_at, self._to_look_at = self._to_look_at[:most], self._to_look_at[most:]
        for name in [f"block_{name}" for name in looked_at if name == "late" or int(name[1:]) in self._days]:
            await self._rewrite_blocks(connection, name)

    async def _rewrite_blocks(self, connection: Connection, name: str) -> None:
        """Of blocks, where those of most nodes were too old."""
        live = await connection.fetchval(f"SELECT sum(octet_length(data) + {_BLOCK_BYTES:d})::bigint FROM {name}")
        await self._rewrite(connection, name, live or 0)

    async def _rewrite(self, connection: Connection, name: str, live_bytes: int) -> None:
        size = await connection.fetchval("SELECT pg_total_relation_size($1::text::regclass)", name)
        if size > _SPARE_BYTES + 2 * live_bytes:
            await connection.execute(f"VACUUM (FULL) {name}")

    async def _cut_bounded(self, connection: Connection, most_bytes: int) -> None:
        """Remove the oldest of the series that takes more than its part, and give the space back."""
        number = self._ids.get(BOUNDED, 0)
        if (cut := cut_of(await connection.fetch(SIZES, number), most_bytes)) is None:
            return
        touched = await connection.fetch(PARTITIONS_OF, number, cut)
        await self._remove_old(connection, {number: cut + 1})
        for (name,) in touched:
            await connection.execute(f"VACUUM (FULL) {name}")

    async def _remove_most(self, connection: Connection, now: int, most_bytes: int, tries: int) -> bool:
        """Remove the oldest day, and again while there is too much; of the last one a part.

        Returns:
            Whether there is more to do now.
        """
        self._tries = None  # where it fails, the next round begins anew, and others have their turn
        used = await used_bytes(connection)
        if not tries or used <= most_bytes:
            self.over_limit = over_limit_text(used, most_bytes)
            return bool(self._aged or self._large)
        if await connection.fetchval("SELECT EXISTS (SELECT FROM sample_late) OR EXISTS (SELECT FROM block_late)"):
            await connection.execute("TRUNCATE sample_late, block_late")
        elif len(self._days) > 1:
            await self._drop_day(connection, min(self._days))
        elif self._days:
            await self._shorten_day(connection, min(self._days), now, most_bytes / used)
        await self._count_again(connection)
        self._tries = tries - 1
        return True

    async def _shorten_day(self, connection: Connection, day: int, now: int, share: float) -> None:
        """Remove the older part of a day, so that about such a share stays."""
        oldest, newest = await connection.fetchrow(
            # A block goes as a whole: so at least one does. Rows of other days say nothing of where this one ends.
            f"SELECT least((SELECT min(last) FROM block_d{day:d}), (SELECT min(time) FROM sample_d{day:d})),"
            f" greatest((SELECT max(last) FROM block_d{day:d}), (SELECT max(time) FROM sample_d{day:d}))"
        )
        before = now if oldest is None else oldest + int((newest - oldest) * (1.05 - share)) + 1
        for table, column in (("sample", "time"), ("block", "last")):
            await connection.execute(f"DELETE FROM {table}_d{day:d} WHERE {column} < {before:d}")
            await connection.execute(f"VACUUM (FULL) {table}_d{day:d}")

    async def _add_rows(
        self, connection: Connection, found: Rows, number: int, first: int, last: int, *, backward: bool
    ) -> None:
        """Add those of a node that are in no block, piece by piece where they are large."""
        while found.room:
            room_bytes = found.room_bytes
            rows = await connection.fetch(ROWS[backward], found.room, room_bytes, number, first, last)
            try:
                with uncollected():
                    found.take(decode_value(*row) for row in rows)
            except BROKEN as error:
                raise self._broken(error) from error
            if sum(len(value) for _, _, value in rows) <= room_bytes:
                break
            first, last = (first, rows[-1][0] - 1) if backward else (rows[-1][0] + 1, last)

    def _broken(self, error: Exception) -> StorageUnavailable:
        return StorageUnavailable(f"{self.name}: a block of the history is broken ({error}); restore a backup of it")

    def between(self, key: NodeId, first: int, last: int, found: Rows, *, backward: bool) -> Rows:
        """Rows of a node, as `Series.between`, added to `found`."""
        if first <= last and found.room:
            last = min(last, LATEST)
            self._database.run(lambda connection: self._between(connection, key, first, last, found, backward))
        return found

    async def _between(
        self, connection: Connection, key: NodeId, first: int, last: int, found: Rows, backward: bool
    ) -> None:
        number = self._ids.get(key)
        if number is None:
            return
        if backward:
            await self._add_rows(connection, found, number, first, last, backward=True)
        low, high = max(first - first % DAY, 0), last  # a block is within one day
        while found.room:
            limit = min(_BLOCKS_READ, 1 + found.room // 500)
            blocks = await connection.fetch(BLOCKS[backward], limit, _BLOCKS_BYTES, number, low, high, first)
            with uncollected():
                for start, data in blocks:
                    self._add_block(found, (number, start), data, first, last, backward=backward)
                    low, high = (low, start - 1) if backward else (start + 1, high)
            if len(blocks) < limit and sum(len(data) for _, data in blocks) <= _BLOCKS_BYTES:
                break
        if not backward:
            await self._add_rows(connection, found, number, first, last, backward=False)

    def _add_block(
        self, found: Rows, key: tuple[int, int], data: bytes, first: int, last: int, *, backward: bool
    ) -> None:
        """Add those of a block."""
        if key not in self._decoded:
            try:
                self._decoded.add(key, data)
            except BROKEN as error:
                raise self._broken(error) from error
        self._decoded.put_into(found, key, first, last, backward=backward)


class PostgresSeries:
    """The rows of one node."""

    def __init__(self, store: PostgresHistory, key: NodeId) -> None:
        self._store, self._key = store, key

    def between(
        self, first: int, last: int, most: int, *, backward: bool = False, most_bytes: int = MOST_READ_BYTES
    ) -> Rows:
        """As the protocol says."""
        return self._store.between(self._key, first, last, Rows(most, most_bytes), backward=backward)
