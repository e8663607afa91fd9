"""A rate limit where the latest wins and the last one always arrives. Time is an argument."""

from __future__ import annotations

from typing import Generic, TypeVar

__all__ = ["RateLimit"]

T = TypeVar("T")


class RateLimit(Generic[T]):
    """Lets at most `max_rate_hz` items a second through.

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
