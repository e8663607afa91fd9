"""A rate limit where the latest wins and the last one always arrives: the rule, and the gate that keeps its time."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["RateGate", "RateLimit", "ThreadedGate"]

T = TypeVar("T")


class RateLimit(Generic[T]):
    """Lets at most `max_rate_hz` items a second through. Time is an argument.

    An item that comes too early waits; a newer one takes its place. The owner calls `take` at `due`.
    """

    def __init__(self, max_rate_hz: float) -> None:
        self._period_s = 1.0 / max_rate_hz
        self._next = float("-inf")
        self._waiting: T | None = None

    def offer(self, item: T, now: float) -> tuple[T | None, bool]:
        """The item when its turn is now, else None; and whether an older one that waited was dropped."""
        replaced = self._waiting is not None
        if now >= self._next:
            self._waiting = None
            self._next = now + self._period_s
            return item, replaced
        self._waiting = item
        return None, replaced

    @property
    def due(self) -> float | None:
        """When `take` will give the item that waits; None when none does."""
        return None if self._waiting is None else self._next

    def take(self, now: float) -> T | None:
        """The item that waits, if its turn has come."""
        if self._waiting is None or now < self._next:
            return None
        item, self._waiting = self._waiting, None
        self._next = now + self._period_s
        return item

    def drain(self) -> T | None:
        """The item that waits, before its turn."""
        item, self._waiting = self._waiting, None
        return item


class RateGate(Generic[T]):
    """Hands items on at the limited rate, in an event loop."""

    def __init__(
        self,
        max_rate_hz: float,
        loop: asyncio.AbstractEventLoop,
        deliver: Callable[[T], object],
        replaced: Callable[[], object],
    ) -> None:
        """`deliver` gets the items whose turn it is; `replaced` is called for each that a newer one pushed out."""
        self._limit = RateLimit[T](max_rate_hz)
        self._loop = loop
        self._deliver = deliver
        self._replaced = replaced
        self._timer: asyncio.TimerHandle | None = None

    def offer(self, item: T) -> None:
        """Hand the item on now or when its turn comes."""
        passed, replaced = self._limit.offer(item, self._loop.time())
        if replaced:
            self._replaced()
        if passed is not None:
            self._deliver(passed)
        elif self._timer is None:
            self._schedule()

    def flush(self) -> None:
        """Hand on what waits, at once: nothing comes after it."""
        self.close()
        item = self._limit.drain()
        if item is not None:
            self._deliver(item)

    def close(self) -> None:
        """Stop the timer."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _schedule(self) -> None:
        due = self._limit.due
        self._timer = None if due is None else self._loop.call_at(due, self._fire)

    def _fire(self) -> None:
        item = self._limit.take(self._loop.time())
        self._schedule()
        if item is not None:
            self._deliver(item)


class ThreadedGate(Generic[T]):
    """A RateGate that is offered items from any thread, and keeps one: nothing queues up while the event loop is busy.

    An item whose turn it is is handed on in the thread that offers it, so `deliver` and `replaced` are called in any
    thread, one at a time, and must not block; a queue with a bound of its own is meant.
    """

    def __init__(
        self,
        max_rate_hz: float,
        loop: asyncio.AbstractEventLoop,
        deliver: Callable[[T], object],
        replaced: Callable[[], object],
    ) -> None:
        """See RateGate; the event loop has its timer alone."""
        self._limit = RateLimit[T](max_rate_hz)
        self._loop, self._deliver, self._replaced = loop, deliver, replaced
        self._lock = threading.Lock()
        self._has_timer = False

    def offer(self, item: T) -> None:
        """Hand the item on now, or when its turn comes."""
        with self._lock:
            passed, replaced = self._limit.offer(item, self._loop.time())
            if replaced:
                self._replaced()
            if passed is not None:
                self._deliver(passed)
            elif not self._has_timer:
                self._has_timer = True
                self._loop.call_soon_threadsafe(self._arm)

    def flush(self, then: Callable[[], object]) -> None:
        """Hand on what waits, and do what comes after it; nothing else is handed on between."""
        with self._lock:
            item = self._limit.drain()
            if item is not None:
                self._deliver(item)
            then()

    def _arm(self) -> None:
        with self._lock:
            due = self._limit.due
            self._has_timer = due is not None
            if due is not None:
                self._loop.call_at(due, self._fire)

    def _fire(self) -> None:
        with self._lock:
            item = self._limit.take(self._loop.time())
            if item is not None:
                self._deliver(item)
        self._arm()
