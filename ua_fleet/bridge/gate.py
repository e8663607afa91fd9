"""The shell of a rate limit: it gets items in any thread, and hands on what waits by a timer of the event loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from ua_fleet.rate import RateLimit

__all__ = ["RateGate"]

T = TypeVar("T")


class RateGate(Generic[T]):
    """Hands items on at the limited rate, and keeps one: nothing queues up while the event loop is busy.

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
        """`deliver` gets the items whose turn it is; `replaced` is called for each that a newer one pushed out."""
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

    def flush(self, then: Callable[[], object] | None = None) -> None:
        """Hand on what waits, and do what comes after it; nothing else is handed on between."""
        with self._lock:
            item = self._limit.drain()
            if item is not None:
                self._deliver(item)
            if then is not None:
                then()

    def close(self) -> None:
        """Hand nothing on of what waits."""
        with self._lock:
            self._limit.drain()

    def _arm(self) -> None:
        with self._lock:
            due = self._limit.due
            self._has_timer = due is not None
            if due is not None:
                self._loop.call_at(due, self._fire)

    def _fire(self) -> None:
        with self._lock:
            item = self._limit.pop(self._loop.time())
            if item is not None:
                self._deliver(item)
        self._arm()
