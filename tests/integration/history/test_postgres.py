"""The PostgreSQL store beyond its contract: what can be wrong with it, and kills of both sides at any moment."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import random
import signal
import sys
import time
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from tests.forking import ForkedProcess
from tests.postgres import PASSWORD, USER, Postgres
from tests.system import forked
from tests.unit.config.test_history import SPEED, config_of
from ua_fleet.config.history import HistoryRules
from ua_fleet.config.nodes import fleet_model
from ua_fleet.errors import StorageAway, StorageUnavailable
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.history.continuation import Continuations
from ua_fleet.history.raw import Phase, Position, RawRead
from ua_fleet.history.rows import BAD_DATA_LOST, EARLIEST, LATEST, Row
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.server.history import HistoryService, Opening
from ua_fleet.values import TICKS_PER_SECOND, NodeId, ticks_from_unix_ns

pytestmark = pytest.mark.needs("postgres")
pytest.importorskip("asyncpg")
from ua_fleet.storage.postgres import PostgresDatabase  # noqa: E402
from ua_fleet.storage.postgres_history import PostgresHistory  # noqa: E402 - without asyncpg it cannot be

KEY = NodeId(2, 1001)
DAY = 86_400 * TICKS_PER_SECOND
NOON = 155_092 * DAY + DAY // 2
HUGE = 2**40
_number = itertools.count(1)


@pytest.fixture
def url(postgres: Postgres) -> Iterator[str]:
    with postgres.database(f"history_{next(_number)}") as made:
        yield made


@pytest.fixture
def own() -> Iterator[Postgres]:
    """One that a test may kill."""
    with Postgres() as started:
        yield started


def database_of(url: str) -> str:
    return url.rpartition("/")[2]


def rows(first: int, count: int, start: int = NOON) -> list[tuple[NodeId, Row]]:
    return [(KEY, Row(start + number, 0, 11, float(number))) for number in range(first, first + count)]


def times(store: PostgresHistory) -> list[int]:
    return [row.time - NOON for row in store.series(KEY).between(EARLIEST, LATEST, 10_000_000)]


def test_what_is_wrong_at_the_start_is_told_with_its_remedy(postgres: Postgres, url: str) -> None:
    with pytest.raises(StorageUnavailable, match=r"password authentication failed.*history\.password_file") as refused:
        PostgresHistory(url, USER, "wrong")
    assert "wrong" not in str(refused.value)
    with pytest.raises(StorageUnavailable, match="password_file"):
        PostgresHistory(url, USER, None)
    with pytest.raises(
        StorageUnavailable, match=rf'"nowhere" does not exist; make it: createdb --owner {USER} nowhere'
    ):
        PostgresHistory(postgres.url("nowhere"), USER, PASSWORD)
    with pytest.raises(StorageUnavailable, match=r"cannot be reached.*see whether PostgreSQL runs there"):
        PostgresHistory(url.replace(str(postgres.port), "1"), USER, PASSWORD)
    postgres.run(f"CREATE ROLE guest LOGIN PASSWORD '{PASSWORD}'", database_of(url))
    try:
        with pytest.raises(StorageUnavailable, match="GRANT CREATE ON DATABASE"):
            PostgresHistory(url, "guest", PASSWORD)
    finally:
        postgres.run("DROP ROLE guest")


def test_a_store_of_a_newer_version_is_left_alone(postgres: Postgres, url: str) -> None:
    PostgresHistory(url, USER, PASSWORD).close()
    postgres.run("UPDATE ua_fleet_history.meta SET value = '99' WHERE name = 'version'", database_of(url))
    with pytest.raises(StorageUnavailable, match=r"has version 99.*upgrade ua-fleet"):
        PostgresHistory(url, USER, PASSWORD)


def test_two_servers_do_not_share_a_store(url: str) -> None:
    with contextlib.closing(PostgresHistory(url, USER, PASSWORD)) as store:
        with pytest.raises(StorageUnavailable, match="in use by another server"):
            PostgresHistory(url, USER, PASSWORD)
        store.write(rows(0, 3), NOON)
    with contextlib.closing(PostgresHistory(url, USER, PASSWORD)) as store:
        assert times(store) == [0, 1, 2]


def test_what_a_read_only_database_does_not_take_is_taken_later(postgres: Postgres, url: str) -> None:
    name = database_of(url)
    with contextlib.closing(PostgresHistory(url, USER, PASSWORD)) as store:
        store.write(rows(0, 3), NOON)
        postgres.run(f"ALTER DATABASE {name} SET default_transaction_read_only = on")
        postgres.run(f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '{name}'")
        with contextlib.suppress(StorageUnavailable):  # the one that notices
            store.write(rows(3, 3), NOON)
        with pytest.raises(StorageUnavailable, match=r"read only.*name the primary server"):
            store.write(rows(3, 3), NOON)
        assert times(store) == [0, 1, 2]
        postgres.run(f"ALTER DATABASE {name} RESET default_transaction_read_only")
        postgres.run(f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = '{name}'")
        with contextlib.suppress(StorageUnavailable):
            store.write(rows(3, 3), NOON)
        store.write(rows(3, 3), NOON)
        assert times(store) == [0, 1, 2, 3, 4, 5]


def test_a_row_that_is_far_ahead_does_not_cost_the_day(url: str) -> None:
    with contextlib.closing(PostgresHistory(url, USER, PASSWORD)) as store:
        store.write([(KEY, Row(NOON + at * TICKS_PER_SECOND, 0, 11, float(at))) for at in range(1_900)], NOON)
        store.write([(NodeId(2, 7), Row(NOON + 3_650 * DAY, 0, 11, 1.0))], NOON)
        most = store.used_bytes() * 9 // 10
        store.tend(NOON + DAY // 4, lambda _key: 10_000, most)
        assert store.series(KEY).between(EARLIEST, LATEST, 1)


def test_a_broken_block_costs_the_read_and_says_so(postgres: Postgres, url: str) -> None:
    with contextlib.closing(PostgresHistory(url, USER, PASSWORD)) as store:
        store.write(rows(0, 4_000), NOON)
        while store.tend(NOON, lambda _key: 1e6, HUGE):
            pass
        broken = "UPDATE ua_fleet_history.block SET data = substr(data, 1, 60) WHERE first = "
        postgres.run(f"{broken}{NOON}", database_of(url))
        with pytest.raises(StorageUnavailable, match=r"is broken.*restore a backup"):
            times(store)
        assert store.series(KEY).between(NOON + 1_500, LATEST, 1)[0].time == NOON + 1_500


def test_days_are_partitions_that_are_dropped_whole(postgres: Postgres, url: str) -> None:
    name, names = database_of(url), "SELECT relname FROM pg_class WHERE relname ~ '^(sample|block)_d[0-9]+$' ORDER BY 1"
    with contextlib.closing(PostgresHistory(url, USER, PASSWORD)) as store:
        for day in range(6):
            store.write(rows(0, 2_500, NOON + day * DAY), NOON + day * DAY)
            while store.tend(NOON + day * DAY, lambda _key: 3, HUGE):
                pass
        kept = [f"{table}_d{155_092 + day}" for table in ("block", "sample") for day in range(2, 6)]
        assert postgres.run(names, name).split() == kept
        assert times(store)[0] == 2 * DAY
        plan = postgres.run(
            "EXPLAIN SELECT * FROM ua_fleet_history.sample WHERE node = 1"
            f" AND time BETWEEN {NOON + 3 * DAY} AND {NOON + 3 * DAY + 5}",
            name,
        )
        assert "sample_d155095" in plan
        assert "sample_d155094" not in plan


def test_a_clock_that_is_years_behind_makes_no_partitions(postgres: Postgres, url: str) -> None:
    old = NodeId(2, 7)
    with contextlib.closing(PostgresHistory(url, USER, PASSWORD)) as store:
        store.write([(old, Row(day * DAY + 1, 0, 11, float(day))) for day in range(155_000, 155_090)], NOON)
        store.write([(old, Row(NOON - 3 * DAY, 0, 11, 0.5))], NOON)
        days = "SELECT count(*) FROM pg_class WHERE relname ~ '^sample_d[0-9]+$'"
        assert postgres.run(days, database_of(url)) == "0"
        # The server's clock was wrong: it is that day now, and what is there moves into the partition of the day.
        store.write([(old, Row(NOON - 3 * DAY + 1, 0, 11, 0.75))], NOON - 3 * DAY)
        assert postgres.run(days, database_of(url)) == "1"
        found = store.series(old).between(EARLIEST, LATEST, 1_000)
        assert [row.value for row in found] == [*map(float, range(155_000, 155_090)), 0.5, 0.75]
        assert postgres.run("SELECT count(*) FROM ua_fleet_history.sample_late", database_of(url)) == "89"


_WRITER = """
import sys
from ua_fleet.errors import StorageAway, StorageUnavailable
from ua_fleet.history.rows import Row
from ua_fleet.storage.postgres_history import PostgresHistory
from ua_fleet.values import NodeId
url, user, password, start = *sys.argv[1:4], int(sys.argv[4])
store = PostgresHistory(url, user, password)
key, number = NodeId(2, 1001), len(store.series(NodeId(2, 1001)).between(0, 2**62, 10**7))
while True:
    batch = [(key, Row(start + number + n, 0, 11, float(number + n))) for n in range(700)]
    try:
        store.write(batch, start)
        number += len(batch)
        print(number, flush=True)
        store.tend(start, lambda _key: 1e6, 2**40)
    except StorageUnavailable:
        print("away", flush=True)
"""


@contextlib.contextmanager
def writer(folder: Path, url: str) -> Generator[ForkedProcess]:
    program = folder / "writer.py"
    program.write_text(_WRITER)
    process = forked(sys.executable, program, url, USER, PASSWORD, str(NOON))
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        process.close()


@pytest.mark.parametrize("lines", [2, 3, 5, 9])
def test_what_was_told_as_stored_is_there_after_a_kill_of_the_server(url: str, lines: int, tmp_path: Path) -> None:
    """The process writes and compacts all the time; it is killed when it has told of so many batches."""
    with writer(tmp_path, url) as process:
        told = [int(process.stdout.readline()) for _ in range(lines)]
        os.kill(process.pid, signal.SIGKILL)
        told += [int(line) for line in process.stdout.read().split()]
    with contextlib.closing(PostgresHistory(url, USER, PASSWORD)) as store:
        found = times(store)
    assert found == list(range(len(found)))
    assert len(found) >= told[-1]


@pytest.mark.parametrize("seed", range(3))
def test_what_was_told_as_stored_is_there_after_kills_of_postgres(own: Postgres, seed: int, tmp_path: Path) -> None:
    """It is killed and started again at moments that the seed chooses; the process goes on, and nothing comes twice."""
    random_ = random.Random(seed)
    with writer(tmp_path, own.url()) as process:
        told = int(process.stdout.readline())
        for _ in range(2):
            time.sleep(random_.uniform(0, 0.3))
            own.kill()
            assert own.process is None
            own.start()
            heard = ""
            while heard != "away":  # it has noticed
                heard = process.stdout.readline().strip()
                told = told if heard == "away" else int(heard)
            while heard == "away":  # and goes on
                heard = process.stdout.readline().strip()
            told = int(heard)
    with contextlib.closing(PostgresHistory(own.url(), USER, PASSWORD)) as store:
        found = times(store)
    assert found == list(range(len(found)))
    assert len(found) >= told


async def test_a_database_that_stands_still_or_is_killed_costs_no_live_value(own: Postgres) -> None:
    """The service goes on at once; what waits is stored in order once the database answers again."""
    config = config_of({"store": own.url(), "user": USER, "at_least_each_s": 0})
    rules = HistoryRules(config)
    for robot in fleet_model(config).robots:
        rules.add(robot)
    executor = ThreadPoolExecutor(1)
    loop = asyncio.get_running_loop()
    store = await loop.run_in_executor(executor, PostgresHistory, own.url(), USER, PASSWORD)
    history = HistoryService(store, executor, rules, HUGE, Mistakes())
    longest, number = 0.0, 0

    async def live(seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Record a value each 5 ms, and poll as the core does."""
        nonlocal longest, number
        end = loop.time() + seconds
        while loop.time() < end and not until():
            begin = loop.time()
            history.record(ValueChanged(SPEED, 11, float(number), 0, None, True))
            history.poll(begin)
            longest, number = max(longest, loop.time() - begin), number + 1
            await asyncio.sleep(0.005)

    await live(30, lambda: history.stored > 0)
    own.pause(on=True)
    await live(1.5)
    assert history.waiting > 100
    own.pause(on=False)
    await live(30, lambda: history.waiting < 20)
    await asyncio.to_thread(own.kill)
    await live(30, lambda: bool(history.problem))
    assert "see whether PostgreSQL runs" in history.problem
    await asyncio.to_thread(own.start)
    await live(30, lambda: not history.problem)
    assert longest < 0.1
    assert sum(history.lost.values()) == 0
    found = await history.look(SPEED, lambda series: series.between(EARLIEST, LATEST, 1_000_000))
    await history.close()
    assert [row.value for row in found] == [float(each) for each in range(number)]


def test_a_database_that_does_not_answer_any_more_is_given_up(own: Postgres, monkeypatch: pytest.MonkeyPatch) -> None:
    """Here its processes stand still; a network that swallows all looks the same."""
    with contextlib.closing(PostgresHistory(own.url(), USER, PASSWORD)) as store:
        store.write(rows(0, 3), NOON)
        monkeypatch.setattr(PostgresDatabase.run, "__defaults__", (0.5,))
        own.pause(on=True)
        begin = time.monotonic()
        with pytest.raises(StorageUnavailable, match="cannot be reached"):
            store.write(rows(3, 3), NOON)
        assert time.monotonic() - begin < 5
        own.pause(on=False)
        monkeypatch.undo()
        store.write(rows(3, 3), NOON)
        assert times(store) == [0, 1, 2, 3, 4, 5]


async def test_a_server_starts_without_its_database_and_stores_what_came_once_that_is_there(own: Postgres) -> None:
    """What the last process stored, a gap, then all that came while there was no database, in order."""
    config = config_of({"store": own.url(), "user": USER, "at_least_each_s": 0})
    rules = HistoryRules(config)
    for robot in fleet_model(config).robots:
        rules.add(robot)
    loop = asyncio.get_running_loop()

    def opened() -> PostgresHistory:
        return PostgresHistory(own.url(), USER, PASSWORD)

    store = await asyncio.to_thread(opened)
    begin = ticks_from_unix_ns(time.time_ns())
    await asyncio.to_thread(store.write, [(SPEED, Row(begin, 0, 11, -2.0))], begin)
    secret = store.secret
    await asyncio.to_thread(store.close)
    await asyncio.to_thread(own.kill)
    with pytest.raises(StorageAway, match="see whether PostgreSQL runs") as away:
        await asyncio.to_thread(opened)
    history = HistoryService(Opening(opened, str(away.value)), ThreadPoolExecutor(1), rules, HUGE, Mistakes())
    # The robot's value of before, with its old time, then new ones.
    history.record(ValueChanged(SPEED, 11, -2.0, 0, begin, True))
    longest = 0.0
    for number in range(40):
        now = loop.time()
        history.record(ValueChanged(SPEED, 11, float(number), 0, None, True))
        history.poll(now)
        longest = max(longest, loop.time() - now)
        await asyncio.sleep(0.005)
    assert "see whether PostgreSQL runs" in history.problem
    assert (history.is_stored, history.waiting) == (False, 41)
    with pytest.raises(StorageUnavailable):
        await history.look(SPEED, len)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
    with pytest.raises(StorageUnavailable):
        _ = history.continuations
    await asyncio.to_thread(own.start)
    until = loop.time() + 60
    while history.problem or history.waiting:
        assert loop.time() < until, history.problem
        history.poll(loop.time())
        await asyncio.sleep(0.01)
    history.record(ValueChanged(SPEED, 11, 40.0, 0, None, True))
    found = await history.look(SPEED, lambda series: series.between(EARLIEST, LATEST, 1_000_000))
    point = history.continuations
    await history.close()
    assert [row.value for row in found] == [-2.0, None, -2.0, *map(float, range(41))]
    assert found[1].status == BAD_DATA_LOST
    assert [row.time for row in found] == sorted({row.time for row in found})
    assert longest < 0.1
    read = RawRead(1, 2, 3, False)
    assert Continuations(secret).read_raw("n", point.of_raw("n", read, Position(Phase.WITHIN, 1))) is not None


async def test_a_server_that_ends_before_its_database_came_says_what_is_lost(own: Postgres) -> None:
    rules = HistoryRules(config_of({"store": own.url(), "user": USER}))
    for robot in fleet_model(config_of({})).robots:
        rules.add(robot)

    def never() -> PostgresHistory:
        raise StorageAway("it is away")

    history = HistoryService(Opening(never, "it is away"), ThreadPoolExecutor(1), rules, HUGE, Mistakes())
    history.record(ValueChanged(SPEED, 11, 1.0, 0, None, True))
    with capture_logs() as logs:
        await history.close()
    assert [(each["event"], each["count"]) for each in logs] == [("history ends with values that were not stored", 1)]
