"""What a virtual process has in place of a disk and an event loop."""

from __future__ import annotations

import heapq
import sqlite3
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
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


class VirtualLoop:
    """A TurnLoop on a clock that nobody waits for."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """Begin with nothing to do."""
        self._clock = clock
        self._ready: deque[partial[object]] = deque()
        self._timed: list[tuple[float, int, partial[object]]] = []
        self._order = count()

    def time(self) -> float:
        """See TurnLoop."""
        return self._clock()

    def call_soon(self, callback: Callable[..., object], *args: Any) -> None:
        """See TurnLoop."""
        self._ready.append(partial(callback, *args))

    def call_later(self, delay: float, callback: Callable[..., object], *args: Any) -> None:
        """See TurnLoop."""
        heapq.heappush(self._timed, (self._clock() + delay, next(self._order), partial(callback, *args)))

    def run_ready(self) -> None:
        """Do all that is due now, and what follows from it."""
        while self._timed and self._timed[0][0] <= self._clock():
            self._ready.append(heapq.heappop(self._timed)[2])
        while self._ready:
            self._ready.popleft()()

    def next_deadline(self) -> float | None:
        """When `run_ready` has something to do, or None."""
        return self._timed[0][0] if self._timed else None
