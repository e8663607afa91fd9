"""The shell of history: values as they change, a thread with the store, and reads beside both.

    core, clients' writes -> record -> Recorder -> Backlog -> (thread) HistoryStore
    HistoryRead -> look -> (thread) the rows of a node

The thread does one thing at a time, in its order. So a read sees what was recorded before it, and the database is
nobody else's. A value never waits for the store: while that is slow or away, rows wait in the backlog, and what comes
once it is full is counted and marked.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

import structlog

from ua_fleet.config.history import HistoryRules
from ua_fleet.config.history_schema import MEGABYTE, HistoryConfig
from ua_fleet.errors import StorageAway, StorageUnavailable
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.history.backlog import Backlog, Full
from ua_fleet.history.continuation import Continuations
from ua_fleet.history.events import AUDIT_EVENTS, EVENTS, EventRecorder, MergedSeries
from ua_fleet.history.recorder import Kept, Recorder
from ua_fleet.history.rows import ListSeries, Series
from ua_fleet.history.store import HistoryStore
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.server.history_opening import Opening, open_store
from ua_fleet.values import TICKS_PER_SECOND, NodeId, ticks_from_unix_ns

__all__ = ["HistoryService", "Opening", "open_history"]

_log: Any = structlog.get_logger("ua_fleet.server")

MOST_WAITING: Final = 100_000
"""Rows that the store has not taken yet, with some 30 MB where they are numbers."""
MOST_WAITING_BYTES: Final = 64_000_000
"""What they take in memory at most."""
WRITE_S: Final = 0.25
"""Seconds from one commit to the next at least, but where somebody reads."""
ALIVE_S: Final = 10.0
"""How often the store is told that the server runs, where there is nothing else to write."""
LONGEST_PAUSE_S: Final = 10.0
"""Between two tries while the store is away."""
CLOSING_S: Final = 5.0
"""What the last commit may take."""

Found = TypeVar("Found")


def _wall() -> int:
    return ticks_from_unix_ns(time.time_ns())


async def open_history(
    config: HistoryConfig, rules: HistoryRules, config_dir: Path, state_dir: Path, mistakes: Mistakes
) -> HistoryService:
    """Open the store of a server.

    Raises:
        StorageUnavailable: it cannot be used.
    """
    executor = ThreadPoolExecutor(1, thread_name_prefix="history")
    opening = partial(open_store, config, config_dir, state_dir)
    store: HistoryStore | Opening
    try:
        store = await asyncio.get_running_loop().run_in_executor(executor, opening)
    except StorageAway as error:
        _log.warning("history is not stored yet; values wait, and are stored later", reason=str(error))
        store = Opening(opening, str(error))
    except BaseException:
        executor.shutdown()
        raise
    return HistoryService(store, executor, rules, int(config.megabytes * MEGABYTE), mistakes)


class HistoryService:
    """Records, and lets HistoryRead look; a `HistoryPart` of the core, and a `HistorySource` of the endpoint."""

    def __init__(
        self,
        store: HistoryStore | Opening,
        executor: ThreadPoolExecutor,
        rules: HistoryRules,
        most_bytes: int,
        mistakes: Mistakes,
        wall: Callable[[], int] = _wall,
    ) -> None:
        """Take over an open store.

        Args:
            store: used in the thread alone; or how it is opened, again and again until it is there.
            executor: has that thread, and no other.
            rules: what is kept.
            most_bytes: that the store may take.
            mistakes: counts what has cost a row.
            wall: the time.
        """
        self._opening = store if isinstance(store, Opening) else None
        self._opened = None if isinstance(store, Opening) else store
        self._executor, self._most_bytes = executor, most_bytes
        self.rules = rules
        self._mistakes, self._wall = mistakes, wall
        self._loop = asyncio.get_running_loop()
        self._started_at = wall()
        known = self._opened
        before: Mapping[NodeId, int] = {} if known is None else known.last_times()
        stopped_at = 0 if known is None else known.stopped_at
        self._recorder = Recorder(rules.of, before, stopped_at)
        self._events = EventRecorder({key: before[key] for key in (EVENTS, AUDIT_EVENTS) if key in before}, stopped_at)
        self._backlog = Backlog(MOST_WAITING, MOST_WAITING_BYTES)
        self._writing: asyncio.Future[Any] | None = None
        self._tending: asyncio.Future[bool] | None = None
        self._next_write = self._next_tend = 0.0
        self._pause_s = 0.0
        self._is_tends_turn = False
        """Whether the store was written to since it was last tended. Both take turns: one alone would have all time."""
        self._is_closed = False
        self.sooner: Callable[[], None] = lambda: None
        """Called when `poll` is to be called sooner than was said."""
        self._away = "" if self._opening is None else f"history is not stored: {self._opening.reason}"
        self._untended = ""
        """Why nothing is stored, and why nothing is removed."""
        self.stored = 0
        """Rows since the start."""

    @property
    def problem(self) -> str:
        """What is wrong with the store; empty while it does its part."""
        return "; ".join(filter(None, (self._away, self._untended)))

    @property
    def is_stored(self) -> bool:
        """Whether the store takes rows."""
        return not self._away

    @property
    def lost(self) -> Mapping[Full, int]:
        """Rows that came while the backlog was full, by its bound."""
        return {cause: self._backlog.lost[cause] for cause in Full}

    @property
    def waiting(self) -> int:
        """Rows that are not stored yet."""
        return len(self._backlog)

    # The core's part.

    def record(self, change: ValueChanged) -> None:
        """Keep a value, if it is to be kept."""
        try:
            kept = self._recorder.take(change, self._wall())
        except Exception as error:  # noqa: BLE001 - the value is shown all the same
            self._mistakes.caught("history", error, node=str(change.key))
            return
        if kept:
            self._add(kept)

    def record_event(self, time: int, data: bytes, *, is_audit: bool) -> None:
        """Keep an event that `encode_event` has made; its Time in ticks."""
        self._add(self._events.take(time, data, self._wall(), is_audit=is_audit), gives_way=is_audit)

    def forget(self, keys: Iterable[NodeId]) -> None:
        """These nodes are gone; what is stored of them stays for as long as it was to."""
        if kept := [row for key in keys for row in self._recorder.forget(key)]:
            self._add(kept)

    def poll(self, now: float) -> None:
        """Begin to write what waits, or to tend the store, if it is time."""
        if self._is_closed:
            return
        if due := self._recorder.poll(self._wall()):
            self._add(due)
        if self._writing is not None or self._tending is not None:
            return
        is_tend_due = now >= self._tend_at
        if now >= self._write_at and not (is_tend_due and self._is_tends_turn):
            if self._opening is not None:
                self._open(self._opening)
            else:
                self._write(now)
        elif is_tend_due:
            self._tend(now)

    def next_deadline(self, now: float) -> float | None:
        """When `poll` is to be called next."""
        if self._is_closed:
            return None
        times: list[float] = []
        if self._writing is None and self._tending is None:
            times += [self._write_at, self._tend_at]
        if (due := self._recorder.next_due()) is not None:
            times.append(now + max(0, due - self._wall()) / TICKS_PER_SECOND)
        return min(times, default=None)

    @property
    def _write_at(self) -> float:
        has_work = len(self._backlog) or self._opening is not None
        return self._next_write if has_work else self._next_write + ALIVE_S

    @property
    def _tend_at(self) -> float:
        """When the store is tended: between two writes too, but not while it is away."""
        if self._opening is not None:
            return math.inf
        return max(self._next_tend, self._next_write) if self._away else self._next_tend

    def _add(self, kept: list[Kept], *, gives_way: bool = False) -> None:
        was_empty = not len(self._backlog)
        self._backlog.add(kept, gives_way=gives_way)
        if was_empty:
            self.sooner()

    # The thread.

    @property
    def _store(self) -> HistoryStore:
        """The store; raises StorageUnavailable while it has never been there."""
        if self._opened is None:
            raise StorageUnavailable(self._away)
        return self._opened

    def _open(self, opening: Opening) -> None:
        """Try to open a store that was away at the start, and put what has come since behind what it has."""
        self._writing = trying = self._loop.run_in_executor(self._executor, self._open_in_thread, opening)

        def done(tried: asyncio.Future[None]) -> None:
            self._writing = None
            error = None if tried.cancelled() else tried.exception()
            if self._opened is None:
                self._has_failed(error)
            else:
                self._opening = None
                stored, stopped_at = self._opened.last_times(), self._opened.stopped_at
                waiting = self._backlog.put_behind(stored, stopped_at, self._started_at)
                self._recorder.put_behind(stored, stopped_at, waiting)
                self._events.put_behind(stored, stopped_at, waiting)
                self._has_worked()
            self.sooner()

        trying.add_done_callback(done)

    def _open_in_thread(self, opening: Opening) -> None:
        self._opened = opening.open()

    def _write(self, now: float) -> asyncio.Future[None]:
        """Have the whole backlog stored in one commit: what fails goes back to where it was."""
        batch, wall = self._backlog.take(), self._wall()
        self._next_write, self._is_tends_turn = now + WRITE_S, True
        writing = self._loop.run_in_executor(self._executor, self._store.write, batch.rows, wall)
        self._writing = writing

        def done(written: asyncio.Future[None]) -> None:
            self._writing = None
            error = None if written.cancelled() else written.exception()
            if error is None and not written.cancelled():
                self.stored += len(batch.rows)
                # Behind the mark of what was lost stands what a node has now.
                self._add(self._recorder.repeat(self._backlog.taken(), self._wall()))
                self._has_worked()
            else:
                self._backlog.restore()
                self._has_failed(error)
            self.sooner()

        writing.add_done_callback(done)
        return writing

    def _tend(self, now: float) -> None:
        wall = self._wall()
        tending = self._loop.run_in_executor(
            self._executor, self._store.tend, wall, self.rules.days_of, self._most_bytes
        )
        self._tending = tending
        self._next_tend, self._is_tends_turn = now + 1.0, False

        def done(tended: asyncio.Future[bool]) -> None:
            self._tending = None
            error = None if tended.cancelled() else tended.exception()
            if error is not None:
                self._has_not_tended(error)
            elif not tended.cancelled():
                self._has_tended(self._store.over_limit)
                self._next_tend = 0.0 if tended.result() else self._next_tend
            self.sooner()

        tending.add_done_callback(done)

    def _has_worked(self) -> None:
        if self._away:
            _log.info("history is stored again", lost=sum(self.lost.values()))
        self._away, self._pause_s = "", 0.0

    def _has_failed(self, error: BaseException | None) -> None:
        self._pause_s = min(max(1.0, 2 * self._pause_s), LONGEST_PAUSE_S)
        self._next_write, self._is_tends_turn = self._loop.time() + self._pause_s, False
        reason = self._reason(error)
        if not self._away:
            _log.warning("history is not stored; values wait, and are stored later", reason=reason)
        self._away = f"history is not stored: {reason}"

    def _has_tended(self, over_limit: str) -> None:
        if over_limit and not self._untended:
            _log.warning("the history takes more than it may", reason=over_limit)
        self._untended = over_limit and f"history is stored, but {over_limit}"

    def _has_not_tended(self, error: BaseException) -> None:
        """Values are stored all the same; the store grows until this is mended."""
        self._next_tend = self._loop.time() + LONGEST_PAUSE_S
        reason = self._reason(error)
        if not self._untended:
            _log.warning("old values of the history are not removed, and new ones not compacted", reason=reason)
        self._untended = f"history is stored, but its old values are not removed: {reason}"

    def _reason(self, error: BaseException | None) -> str:
        """Why the store did not do its part. What is no fault of the store is a mistake of ours."""
        if isinstance(error, StorageUnavailable):
            return str(error)
        if error is not None:
            self._mistakes.caught("history", error if isinstance(error, Exception) else RuntimeError(str(error)))
        return "a mistake, see the log"

    # The endpoint's source.

    @property
    def continuations(self) -> Continuations:
        """What makes continuation points; raises StorageUnavailable while the store has never been there."""
        return Continuations(self._store.secret)

    def is_stepped(self, key: NodeId) -> bool | None:
        """Whether a node's value holds until the next one; None for a node without a history."""
        return self.rules.is_stepped(key)

    @property
    def has_events(self) -> bool:
        """Whether events are kept."""
        return self.rules.events is not None

    async def look(self, key: NodeId, work: Callable[[Series], Found]) -> Found:
        """Do work on the rows of a node in the thread; raises StorageUnavailable."""
        return await self._look((key,), work)

    async def look_at_events(self, work: Callable[[Series], Found], *, audit: bool) -> Found:
        """Do work on events in the thread, with AuditEvents or without; raises StorageUnavailable."""
        return await self._look((EVENTS, AUDIT_EVENTS) if audit else (EVENTS,), work)

    async def _look(self, keys: tuple[NodeId, ...], work: Callable[[Series], Found]) -> Found:
        if self._is_closed:
            raise StorageUnavailable("the server ends")
        store = self._store
        while self._writing is not None:
            await asyncio.wait([self._writing])
        if len(self._backlog) and not self._away:
            await asyncio.wait([self._write(self._loop.time())])
        waiting = self._backlog.of(keys)  # of a store that can be read and not be written, as on a full disk

        def looked() -> Found:
            parts = [store.series(key) for key in keys] + ([ListSeries(waiting)] if waiting else [])
            return work(parts[0] if len(parts) == 1 else MergedSeries(parts))

        return await self._loop.run_in_executor(self._executor, looked)

    async def in_thread(self, work: Callable[[], Any]) -> Any:
        """Do work in the thread that has the store, between its other work."""
        return await self._loop.run_in_executor(self._executor, work)

    async def close(self) -> None:
        """Store what waits, and give the store free."""
        self._is_closed = True
        until = self._loop.time() + CLOSING_S
        while self._writing is not None and self._loop.time() < until:
            await asyncio.wait([self._writing], timeout=until - self._loop.time())
        self._backlog.add(self._recorder.finish())
        self._backlog.mark_gaps()
        if self._writing is None and self._opened is not None:  # otherwise the store does not answer
            with suppress(StorageUnavailable, TimeoutError):
                await asyncio.wait_for(asyncio.shield(self._write(self._loop.time())), CLOSING_S)
        if count := self._backlog.untaken:
            _log.warning("history ends with values that were not stored", count=count)
        closing = self._loop.run_in_executor(self._executor, self._close_in_thread)
        done, _ = await asyncio.wait([closing], timeout=CLOSING_S)
        # A disk that does not answer must not keep the process: its end takes the thread along.
        self._executor.shutdown(wait=bool(done))

    def _close_in_thread(self) -> None:
        if self._opened is not None:
            self._opened.close()
