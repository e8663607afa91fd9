"""What a virtual process has in place of a disk and an event loop."""

from __future__ import annotations

import asyncio
import heapq
import sqlite3
from collections import deque
from collections.abc import Callable, Sequence
from contextvars import Context
from itertools import count
from pathlib import Path
from typing import Any

from ua_fleet.storage.database import Database

__all__ = ["MemoryDatabase", "VirtualLoop"]


class MemoryDatabase(Database):
    """A database without a file: the same statements, and nothing to sync."""

    def __init__(self, schema: Sequence[str]) -> None:
        """Make an empty one with these tables."""
        self.path = Path(":memory:")
        self._shares_sync = self._is_unsynced = False
        self._failed_sync = ""
        self._connection = sqlite3.connect(self.path, isolation_level=None)
        for statement in schema:
            self._connection.execute(statement)

    def settle(self) -> None:
        """There is no disk."""


class VirtualLoop(asyncio.AbstractEventLoop):
    """Those parts of an event loop that a bridge needs that carries runs, on a clock that nobody waits for."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """Begin with nothing to do."""
        self._clock = clock
        self._ready: deque[asyncio.Handle] = deque()
        self._timed: list[tuple[float, int, asyncio.TimerHandle]] = []
        self._order = count()

    def time(self) -> float:
        """See AbstractEventLoop."""
        return self._clock()

    def get_debug(self) -> bool:
        """See AbstractEventLoop."""
        return False

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        """Raise what a callback has raised: it must not happen here."""
        raise context["exception"]

    def call_soon(self, callback: Callable[..., object], *args: Any, context: Context | None = None) -> asyncio.Handle:
        """See AbstractEventLoop."""
        handle = asyncio.Handle(callback, args, self, context)
        self._ready.append(handle)
        return handle

    def call_later(
        self, delay: float, callback: Callable[..., object], *args: Any, context: Context | None = None
    ) -> asyncio.TimerHandle:
        """See AbstractEventLoop."""
        return self.call_at(self._clock() + delay, callback, *args, context=context)

    def call_at(
        self, when: float, callback: Callable[..., object], *args: Any, context: Context | None = None
    ) -> asyncio.TimerHandle:
        """See AbstractEventLoop."""
        handle = asyncio.TimerHandle(when, callback, args, self, context)
        heapq.heappush(self._timed, (when, next(self._order), handle))
        return handle

    def run_ready(self) -> None:
        """Do all that is due now, and what follows from it."""
        while self._timed and self._timed[0][0] <= self._clock():
            self._ready.append(heapq.heappop(self._timed)[2])
        while self._ready:
            handle = self._ready.popleft()
            if not handle.cancelled():
                handle._run()  # noqa: SLF001 - as each event loop does

    def next_deadline(self) -> float | None:
        """When `run_ready` has something to do, or None."""
        return self._timed[0][0] if self._timed else None
