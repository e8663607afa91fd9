"""The tables of a history in PostgreSQL, and what is asked of them.

`sample` and `block` are partitioned by time: one partition for each day, which is dropped as a whole when it is old.
`sample_late` and `block_late` have the rows whose day was over when they came: a robot's clock is wrong, and makes no
partitions.
"""

from __future__ import annotations

from typing import Any, Final

from ua_fleet.storage.postgres import Connection
from ua_fleet.values import TICKS_PER_SECOND

__all__ = [
    "BLOCKS",
    "CREATE_TABLES",
    "DAY",
    "PARTITIONS",
    "PARTITIONS_OF",
    "ROWS",
    "SCHEMA",
    "SET_META",
    "SIZES",
    "TABLES",
    "add_day",
    "used_bytes",
]

SCHEMA: Final = "ua_fleet_history"
DAY: Final = 86_400 * TICKS_PER_SECOND
TABLES: Final = (("sample", "time"), ("block", "first"))
"""What is partitioned, and by which column."""
CREATE_TABLES: Final = (
    "CREATE TABLE meta (name text PRIMARY KEY, value bytea NOT NULL)",
    "CREATE TABLE node (id integer PRIMARY KEY, name bytea NOT NULL UNIQUE)",
    """CREATE TABLE sample (node integer, time bigint, status bigint NOT NULL, value bytea NOT NULL,
        PRIMARY KEY (node, time)) PARTITION BY RANGE (time)""",
    "CREATE TABLE sample_late PARTITION OF sample DEFAULT",
    """CREATE TABLE block (node integer, first bigint, last bigint NOT NULL, data bytea NOT NULL,
        PRIMARY KEY (node, first)) PARTITION BY RANGE (first)""",
    "ALTER TABLE block ALTER data SET STORAGE EXTERNAL",  # it is compressed already
    "CREATE TABLE block_late PARTITION OF block DEFAULT",
)
SET_META: Final = "INSERT INTO meta VALUES ($1, $2) ON CONFLICT (name) DO UPDATE SET value = excluded.value"
_USED: Final = (
    "SELECT coalesce(sum(pg_total_relation_size(inhrelid)), 0)::bigint FROM pg_inherits"
    " WHERE inhparent IN ('sample'::regclass, 'block'::regclass)"
)
PARTITIONS: Final = (
    "SELECT relname FROM pg_inherits JOIN pg_class ON pg_class.oid = inhrelid WHERE inhparent = 'sample'::regclass"
)
SIZES: Final = (
    "SELECT time, octet_length(value) FROM sample WHERE node = $1"
    " UNION ALL SELECT last, octet_length(data) FROM block WHERE node = $1 ORDER BY 1 DESC"
)
"""Of a node's rows and blocks, the newest first."""
PARTITIONS_OF: Final = (
    "SELECT tableoid::regclass::text FROM sample WHERE node = $1 AND time <= $2"
    " UNION SELECT tableoid::regclass::text FROM block WHERE node = $1 AND last <= $2"
)


def _bounded(columns: str, of: str, data: str, order: str) -> str:
    """A query of at most $1 rows, which ends with the one with which its data has more than $2 bytes.

    What PostgreSQL has sent is in memory as a whole; the bytes of what it stores are told without reading it.
    """
    few = f"SELECT {columns} FROM {of} ORDER BY {order} LIMIT $1"
    before = f"sum(octet_length({data})) OVER (ORDER BY {order}) - octet_length({data}) AS before"
    return (
        f"SELECT {columns} FROM (SELECT *, {before} FROM ({few}) AS few) AS counted WHERE before <= $2 ORDER BY {order}"
    )


_SAMPLES: Final = "sample WHERE node = $3 AND time BETWEEN $4 AND $5"
ROWS: Final = tuple(_bounded("time, status, value", _SAMPLES, "value", order) for order in ("time", "time DESC"))
_WITHIN: Final = "block WHERE node = $3 AND first BETWEEN $4 AND $5 AND last >= $6"
BLOCKS: Final = tuple(_bounded("first, data", _WITHIN, "data", order) for order in ("first", "first DESC"))
"""Forward and backward."""


async def used_bytes(connection: Connection) -> int:
    """What all partitions take, with their indexes."""
    used: Any = await connection.fetchval(_USED)
    return int(used)


async def add_day(connection: Connection, day: int) -> None:
    """Make the partitions of a day; what came before them, since a clock was wrong, moves there."""
    low, high = day * DAY, (day + 1) * DAY
    for table, column in TABLES:
        within = f"{column} >= {low:d} AND {column} < {high:d}"
        await connection.execute(f"CREATE TEMPORARY TABLE moved AS SELECT * FROM {table}_late WHERE {within}")
        await connection.execute(f"DELETE FROM {table}_late WHERE {within}")
        await connection.execute(
            f"CREATE TABLE {table}_d{day:d} PARTITION OF {table} FOR VALUES FROM ({low:d}) TO ({high:d})"
        )
        await connection.execute(f"INSERT INTO {table} SELECT * FROM moved; DROP TABLE moved")
