"""The shell of history: what happens to values while the store is slow, away, or comes back."""

from __future__ import annotations

import asyncio
import gc
import threading
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager

import pytest
from structlog.testing import capture_logs

from tests.unit.config.test_history import SPEED, config_of
from ua_fleet.config.history import HistoryRules
from ua_fleet.config.nodes import fleet_model
from ua_fleet.errors import StorageUnavailable
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.history.backlog import Full
from ua_fleet.history.events import EVENTS
from ua_fleet.history.recorder import Kept
from ua_fleet.history.rows import BAD_DATA_LOST, EARLIEST, LATEST, ListSeries, Series
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.server import history as shell
from ua_fleet.server.history import HistoryService, Opening
from ua_fleet.values import TICKS_PER_SECOND, NodeId

S = TICKS_PER_SECOND


class Store:
    """A store in memory that can be away, or take its time."""

    secret = b"secret"
    stopped_at = 0
    over_limit = ""

    def __init__(self) -> None:
        self.rows: list[Kept] = []
        self.is_away = self.is_untended = self.is_full = False
        self.may_go_on = threading.Event()
        self.may_go_on.set()
        self.alive: list[int] = []
        self.is_closed = False
        self.done: list[str] = []
        """What it was told to do, in this order."""
        self.to_tend = 0
        """Pieces of tending that wait."""

    def last_times(self) -> Mapping[NodeId, int]:
        return {}

    def write(self, batch: Sequence[Kept], now: int) -> None:
        self.may_go_on.wait(30)
        self.done.append("write")
        if self.is_away or self.is_full:
            raise StorageUnavailable("history.db: the disk is full; free some space")
        self.rows += batch
        self.alive.append(now)

    def series(self, key: NodeId) -> Series:
        if self.is_away:
            raise StorageUnavailable("history.db: the disk is full; free some space")
        return ListSeries([row for owner, row in self.rows if owner == key])

    def tend(self, now: int, days_of: Callable[[NodeId], float], most_bytes: int) -> bool:
        self.done.append("tend")
        if self.is_untended:
            raise StorageUnavailable("history.db: the disk is full; free some space")
        self.to_tend = max(0, self.to_tend - 1)
        return self.to_tend > 0

    def used_bytes(self) -> int:
        return 0

    def close(self) -> None:
        self.is_closed = True


class Clock:
    """The server's time, which the tests move."""

    def __init__(self) -> None:
        self.second = 100.0

    def __call__(self) -> int:
        return int(self.second * S)


@asynccontextmanager
async def service(store: Store | Opening, clock: Clock) -> AsyncGenerator[HistoryService]:
    config = config_of({})
    rules = HistoryRules(config)
    for robot in fleet_model(config).robots:
        rules.add(robot)
    made = HistoryService(store, ThreadPoolExecutor(1), rules, 2**40, Mistakes(), clock)
    try:
        yield made
    finally:
        await made.close()


def give(history: HistoryService, clock: Clock, *values: float) -> None:
    for value in values:
        clock.second += 1
        history.record(ValueChanged(SPEED, 11, value, 0, clock(), True))


async def polled(history: HistoryService, clock: Clock, until: Callable[[], bool]) -> None:
    """Poll as the core does, in a time that goes by itself."""
    now = asyncio.get_running_loop().time()
    for _ in range(2_000):
        if until():
            return
        now += 1
        history.poll(now)
        deadline = history.next_deadline(now)
        assert deadline is None or deadline >= 0
        await asyncio.sleep(0.002)
    raise AssertionError("it never is so")


def values_in(series: Series) -> list[object]:
    return [row.value for row in series.between(EARLIEST, LATEST, 1000)]


async def test_values_are_stored_and_a_read_sees_those_that_wait() -> None:
    store, clock = Store(), Clock()
    async with service(store, clock) as history:
        give(history, clock, 1.0, 2.0)
        assert await history.look(SPEED, values_in) == [1.0, 2.0]
        give(history, clock, 3.0)
        await polled(history, clock, lambda: len(store.rows) == 3)
        give(history, clock, 3.0)
        assert (history.stored, history.waiting, history.problem) == (3, 0, "")
    assert [row.value for _, row in store.rows] == [1.0, 2.0, 3.0, 3.0]  # the end of the flat part, at the end
    assert store.is_closed


async def test_garbage_is_collected_while_rows_are_calculated_with() -> None:
    """A look may take long, and all garbage of the process would stay for as long."""
    async with service(Store(), Clock()) as history:
        assert await history.look(SPEED, lambda _series: gc.isenabled())


async def test_the_store_is_told_that_the_server_lives() -> None:
    store, clock = Store(), Clock()
    async with service(store, clock) as history:
        await polled(history, clock, lambda: len(store.alive) >= 2)
        assert store.rows == []


async def test_while_the_store_is_away_values_wait_and_what_is_too_much_is_marked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shell, "MOST_WAITING", 3)
    store, clock = Store(), Clock()
    store.is_away = True
    async with service(store, clock) as history:
        give(history, clock, 1.0, 2.0)
        await polled(history, clock, lambda: bool(history.problem))
        assert "the disk is full" in history.problem
        with pytest.raises(StorageUnavailable):
            await history.look(SPEED, values_in)
        give(history, clock, 3.0, 4.0, 5.0)
        assert (history.waiting, history.lost) == (3, {Full.ROWS: 2, Full.BYTES: 0})
        store.is_away = False
        clock.second += 10
        await polled(history, clock, lambda: history.stored == 5)
        assert history.problem == ""
        give(history, clock, 6.0)
        await polled(history, clock, lambda: history.stored == 6)
    rows = [row for _, row in store.rows]
    assert [row.value for row in rows] == [1.0, 2.0, 3.0, None, 5.0, 6.0]
    assert (rows[3].status, rows[3].time) == (BAD_DATA_LOST, 104 * S)
    assert rows[4].time == 115 * S  # what it is when there is room, since it may stay so for days


async def test_a_full_store_hides_no_value_that_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """It can be read: an answer without what the server has beside it would be wrong, and Good."""
    monkeypatch.setattr(shell, "MOST_WAITING", 3)
    store, clock = Store(), Clock()
    async with service(store, clock) as history:
        give(history, clock, 1, 2)
        assert await history.look(SPEED, values_in) == [1, 2]
        store.is_full = True
        give(history, clock, 3)
        await polled(history, clock, lambda: bool(history.problem))
        give(history, clock, 4, 5)
        assert await history.look(SPEED, values_in) == [1, 2, 3, 4, 5]
        assert await history.look(NodeId(2, 4711), values_in) == []
        give(history, clock, 6)
        rows = await history.look(SPEED, lambda series: series.between(EARLIEST, LATEST, 9))
        assert [row.value for row in rows] == [1, 2, 3, 4, 5, None]
        assert rows[-1].status == BAD_DATA_LOST
        store.is_full = False
        clock.second += 10
        await polled(history, clock, lambda: not history.problem)
        assert (await history.look(SPEED, values_in))[:6] == [1, 2, 3, 4, 5, None]


async def test_audit_events_leave_room_for_values(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shell, "MOST_WAITING", 4)
    store, clock = Store(), Clock()
    store.is_away = True
    async with service(store, clock) as history:
        for number in range(10):
            history.record_event(100 * S + number, b"event", is_audit=True)
        give(history, clock, 1.0, 2.0)
        assert (history.waiting, history.lost[Full.ROWS]) == (4, 8)
        store.is_away = False
        await polled(history, clock, lambda: history.stored >= 4)
    assert [row.value for key, row in store.rows if key == SPEED] == [1.0, 2.0]


class Older(Store):
    """One with events of a process that ended at 60 s."""

    stopped_at = 60 * S

    def last_times(self) -> Mapping[NodeId, int]:
        return {EVENTS: 50 * S}


@pytest.mark.parametrize("waits", [False, True])
async def test_events_behind_a_store_that_was_away_at_the_start_have_one_mark(waits: bool) -> None:
    store, clock = Older(), Clock()
    async with service(Opening(lambda: store, "it is away"), clock) as history:
        if waits:
            history.record_event(clock(), b"waits", is_audit=False)
        await polled(history, clock, lambda: history.is_stored and not history.waiting)
        clock.second += 1
        for number in range(2):
            history.record_event(clock() + number, b"event", is_audit=False)
    rows = [row for key, row in store.rows if key == EVENTS]
    assert [row.value for row in rows] == [None, *([b"waits"] if waits else []), b"event", b"event"]
    assert (rows[0].status, rows[0].time) == (BAD_DATA_LOST, 60 * S)


async def test_what_is_lost_just_before_the_end_is_marked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shell, "MOST_WAITING", 1)
    store, clock = Store(), Clock()
    async with service(store, clock) as history:
        give(history, clock, 1.0, 2.0, 3.0)
        assert sum(history.lost.values()) == 2
    rows = [row for _, row in store.rows]
    assert [row.value for row in rows] == [1.0, None]
    assert (rows[1].status, rows[1].time) == (BAD_DATA_LOST, 102 * S)


async def test_that_old_values_are_not_removed_is_no_word_of_new_ones_not_stored() -> None:
    store, clock = Store(), Clock()
    store.is_untended = True
    async with service(store, clock) as history:
        with capture_logs() as logs:
            await polled(history, clock, lambda: bool(history.problem))
        assert [line["event"] for line in logs] == [
            "old values of the history are not removed, and new ones not compacted"
        ]
        assert "is stored, but its old values are not removed: history.db: the disk is full" in history.problem
        assert history.is_stored
        give(history, clock, 1.0)
        await polled(history, clock, lambda: history.stored == 1)
        store.is_untended = False
        await polled(history, clock, lambda: not history.problem)


async def done_in(history: HistoryService, store: Store, clock: Clock, polls: int, pause_s: float) -> str:
    """What the store does while a value comes before each poll: w and t, in a time that goes by itself."""
    now = asyncio.get_running_loop().time() + clock.second
    store.done.clear()
    for number in range(polls):
        give(history, clock, float(number))
        history.poll(now + number * pause_s)
        await history.in_thread(lambda: None)
        await asyncio.sleep(0)
    return "".join(done[0] for done in store.done)


@pytest.mark.parametrize("pause_s", [0.05, 0.3])
async def test_the_store_is_tended_each_second_while_values_keep_coming(pause_s: float) -> None:
    store, clock = Store(), Clock()
    async with service(store, clock) as history:
        done = await done_in(history, store, clock, int(20 / pause_s), pause_s)
        assert 15 <= done.count("t") <= 21
        assert done.count("w") >= 40
        store.over_limit = "takes 12 MB with its old values removed, and history.megabytes is 10"
        await done_in(history, store, clock, int(3 / pause_s), pause_s)
        assert store.over_limit in history.problem


async def test_writes_have_their_turn_while_there_is_much_to_tend() -> None:
    store, clock = Store(), Clock()
    store.to_tend = 1_000
    async with service(store, clock) as history:
        done = await done_in(history, store, clock, 100, 0.3)
        assert "ww" not in done
        assert "tt" not in done
        done = await done_in(history, store, clock, 100, 0.05)
        assert "tttt" in done, "there is time between two writes"
        assert done.count("w") >= 18


async def test_a_store_that_is_away_is_not_tended() -> None:
    store, clock = Store(), Clock()
    async with service(store, clock) as history:
        store.is_away = True
        give(history, clock, 1.0)
        await polled(history, clock, lambda: bool(history.problem))
        assert set(await done_in(history, store, clock, 300, 0.1)) == {"w"}


async def test_a_slow_store_holds_nobody_up() -> None:
    store, clock = Store(), Clock()
    async with service(store, clock) as history:
        store.may_go_on.clear()
        give(history, clock, 1.0)
        history.poll(asyncio.get_running_loop().time() + 1)
        give(history, clock, *range(2, 500))
        assert history.waiting == 498
        reading = asyncio.ensure_future(history.look(SPEED, values_in))
        await asyncio.sleep(0.01)
        assert not reading.done()
        store.may_go_on.set()
        assert len(await reading) == 499


async def test_a_store_that_does_not_answer_does_not_hold_up_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shell, "CLOSING_S", 0.1)
    store, clock = Store(), Clock()
    with capture_logs() as logs:
        async with service(store, clock) as history:
            store.may_go_on.clear()
            give(history, clock, 1.0)
            history.poll(asyncio.get_running_loop().time() + 1)
            give(history, clock, 2.0, 3.0)
            begin = asyncio.get_running_loop().time()
        took_s = asyncio.get_running_loop().time() - begin
        store.may_go_on.set()
    assert took_s < 5
    assert [line["count"] for line in logs if "were not stored" in line["event"]] == [3]


async def test_a_mistake_costs_a_row_and_not_the_value(monkeypatch: pytest.MonkeyPatch) -> None:
    store, clock = Store(), Clock()
    async with service(store, clock) as history:

        def fail(*_given: object) -> list[Kept]:
            raise ZeroDivisionError

        with monkeypatch.context() as patch:
            patch.setattr("ua_fleet.history.recorder.Recorder.take", fail)
            give(history, clock, 1.0)
        give(history, clock, 2.0)
        assert await history.look(SPEED, values_in) == [2.0]


async def test_a_node_that_is_gone_is_not_recorded_twice() -> None:
    store, clock = Store(), Clock()
    async with service(store, clock) as history:
        give(history, clock, 1.0)
        history.forget([SPEED])
        give(history, clock, 2.0)
        found = await history.look(SPEED, lambda series: series.between(EARLIEST, LATEST, 10))
        assert [(row.value, row.status) for row in found] == [(1.0, 0), (None, BAD_DATA_LOST), (2.0, 0)]


async def test_a_store_that_takes_more_than_it_may_is_told_once_and_so_long() -> None:
    store, clock = Store(), Clock()
    async with service(store, clock) as history:
        with capture_logs() as logs:
            store.over_limit = "takes 12 MB with its old values removed, and history.megabytes is 10"
            await polled(history, clock, lambda: bool(history.problem))
            told = len(store.alive)
            await polled(history, clock, lambda: len(store.alive) > told + 3)
        assert history.problem == f"history is stored, but {store.over_limit}"
        assert history.is_stored
        assert [each["event"] for each in logs] == ["the history takes more than it may"]
        store.over_limit = ""
        await polled(history, clock, lambda: not history.problem)
