"""How often something may happen, and how much of it. Pure.

`Budget` is the arithmetic, the only one in this project. `RateLimit` holds items back by it: the latest wins, and the
last one always arrives. Its shell for threads and the event loop is `ua_fleet.bridge.gate`.
"""

from __future__ import annotations

from typing import Generic, TypeVar

__all__ = ["Budget", "RateLimit"]

T = TypeVar("T")


class Budget:
    """An amount that may be spent: it grows by `per_second`, up to `most`, and is full at first. Time is an argument.

    It is kept as the time at which it is full again, so that nothing has to be counted up while nothing is spent.
    """

    __slots__ = ("_full_at", "_most", "_per_second")

    def __init__(self, per_second: float, most: float = 1.0) -> None:
        self._per_second, self._most = per_second, most
        self._full_at = float("-inf")

    def left(self, now: float) -> float:
        """What may be spent now; negative where more was spent than there was."""
        return self._most - max(self._full_at - now, 0.0) * self._per_second

    def at(self, amount: float = 1.0) -> float:
        """The time from which so much is left."""
        return self._full_at - (self._most - amount) / self._per_second

    def spend(self, now: float, amount: float = 1.0) -> None:
        """Spend it, left or not."""
        self._full_at = max(self._full_at, now) + amount / self._per_second

    def take(self, now: float, amount: float = 1.0) -> bool:
        """Spend it, where so much is left."""
        full_at = self._full_at  # as `at` and `spend` have it: each value of a fleet comes by here
        if now < full_at - (self._most - amount) / self._per_second:
            return False
        self._full_at = (full_at if full_at > now else now) + amount / self._per_second
        return True


class RateLimit(Budget, Generic[T]):
    """Lets at most `max_rate_hz` items a second through.

    An item that comes too early waits; a newer one takes its place. The owner calls `pop` at `due`.
    """

    __slots__ = ("_waiting",)

    def __init__(self, max_rate_hz: float, burst: float = 1.0) -> None:
        """`burst` items may pass at once after a pause; more than that pass one by one."""
        super().__init__(max_rate_hz, burst)
        self._waiting: T | None = None

    def offer(self, item: T, now: float) -> tuple[T | None, bool]:
        """The item when its turn is now, else None; and whether an older one that waited was dropped."""
        replaced = self._waiting is not None
        if self.take(now):
            self._waiting = None
            return item, replaced
        self._waiting = item
        return None, replaced

    def passes(self, now: float) -> bool:
        """Whether an item may pass now, without one that waits; it counts as passed."""
        return self._waiting is None and self.take(now)

    def replace(self, item: T) -> None:
        """The item waits for its turn, in place of the one that waits."""
        self._waiting = item

    def overtake(self, now: float) -> None:
        """An item has passed whatever the rate, in place of the one that waits; the next waits for a whole period."""
        self._waiting = None
        self._full_at = now + 1.0 / self._per_second

    @property
    def due(self) -> float | None:
        """When `pop` will give the item that waits; None when none does."""
        return None if self._waiting is None else self.at()

    def pop(self, now: float) -> T | None:
        """The item that waits, if its turn has come."""
        if self._waiting is None or not self.take(now):
            return None
        return self.drain()

    def drain(self) -> T | None:
        """The item that waits, before its turn."""
        item, self._waiting = self._waiting, None
        return item
