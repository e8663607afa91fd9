"""What values take in PostgreSQL once they were removed, and what it takes to remove them."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Generator
from contextlib import contextmanager

import pytest

from tests.postgres import PASSWORD, USER, Postgres
from ua_fleet.history.events import EVENTS
from ua_fleet.history.rows import EARLIEST, LATEST, Row
from ua_fleet.values import TICKS_PER_SECOND, NodeId

pytest.importorskip("asyncpg")
from ua_fleet.storage.postgres_history import PostgresHistory

pytestmark = pytest.mark.needs("postgres")

KEY = NodeId(2, 1001)
DAY = 86_400 * TICKS_PER_SECOND
NOON = 155_092 * DAY + DAY // 2
HUGE = 2**40


@contextmanager
def opened(postgres: Postgres) -> Generator[PostgresHistory]:
    with (
        postgres.database("space") as url,
        contextlib.closing(PostgresHistory(url, USER, PASSWORD)) as store,
    ):
        yield store


def test_the_space_of_values_is_given_back_where_events_are_kept_longer(postgres: Postgres) -> None:
    """Else the database takes what it would if all were kept so long, and days are dropped with their events."""
    numbers = random.Random(1)

    def tended(store: PostgresHistory, now: int, most_bytes: int) -> None:
        while store.tend(now, lambda key: 365.0 if key == EVENTS else 30.0, most_bytes):
            pass

    with opened(postgres) as store:
        for day in range(3):
            begin = NOON + day * DAY
            for part in range(4):
                values = [Row(begin + 2_000 * part + i, 0, 15, numbers.randbytes(200)) for i in range(2_000)]
                store.write([(KEY, row) for row in values], begin)
                tended(store, begin, HUGE)
            store.write([(EVENTS, Row(begin + i, 0, 15, numbers.randbytes(100))) for i in range(300)], begin)
        tended(store, NOON + 4 * DAY, HUGE)
        before = store.used_bytes()
        later = NOON + 60 * DAY
        most = before // 3
        for minute in range(3):
            tended(store, later + minute * 61 * TICKS_PER_SECOND, most if minute == 2 else HUGE)
        assert len(store.series(EVENTS).between(EARLIEST, LATEST, 10_000)) == 900
        assert store.series(KEY).between(EARLIEST, LATEST, 10) == []
        assert store.used_bytes() < most < before
        assert store.over_limit == ""


def rows(first: int, count: int) -> list[Row]:
    return [Row(first + number, 0, 11, float(number)) for number in range(count)]


def test_to_remove_what_is_old_counts_the_rows_of_these_nodes_again_and_no_others(postgres: Postgres) -> None:
    other = NodeId(2, 1002)
    with opened(postgres) as store:
        later = NOON + 2 * DAY
        store.write([(key, row) for key in (KEY, other) for row in rows(NOON, 2_000)], NOON)
        store.write([(KEY, row) for row in rows(later, 500)], later)
        while store.tend(later, lambda key: 1.0 if key == KEY else 365.0, HUGE):
            pass
        assert len(store.series(other).between(EARLIEST, LATEST, 10_000)) == 2_000
        assert store.series(KEY).between(EARLIEST, LATEST, 10_000) == rows(later, 500)
        # What it has counted is where a node becomes large enough for a block.
        store.write([(KEY, row) for row in rows(later + 500, 1_500)], later)
        while store.tend(later, lambda key: 1.0 if key == KEY else 365.0, HUGE):
            pass
        assert len(store.series(KEY).between(EARLIEST, LATEST, 10_000)) == 2_000
