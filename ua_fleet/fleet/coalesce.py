"""Analog values at most so often for each node: the first at once, then the last one of each period, and never none.

Booleans, enumerations, strings and changes of quality pass at once; one that overtakes a waiting value replaces it.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from itertools import count

from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.rate import RateLimit
from ua_fleet.values import NodeId

__all__ = ["Coalescer"]


class Coalescer:
    """Holds back analog values that come too fast. `now` is float seconds of any monotonic clock."""

    def __init__(self, rate_hz: float) -> None:
        """Make a coalescer that lets each node's analog value pass `rate_hz` times a second."""
        self._rate_hz = rate_hz
        self._limits: dict[NodeId, RateLimit[ValueChanged]] = {}
        self._due: list[tuple[float, int, NodeId]] = []
        self._order = count()

    def offer(self, change: ValueChanged, now: float) -> ValueChanged | None:
        """The change if it may be written now; None if it has to wait for `poll`."""
        limit = self._limits.get(change.key)
        if limit is None:
            limit = self._limits[change.key] = RateLimit(self._rate_hz)
        elif not change.can_wait:
            limit.overtake(now)
            return change
        elif limit.passes(now):
            return change
        elif limit.due is not None:
            limit.replace(change)  # `poll` knows when its turn comes
            return None
        passed, _ = limit.offer(change, now)
        if passed is None and limit.due is not None:
            heapq.heappush(self._due, (limit.due, next(self._order), change.key))
        return passed

    def poll(self, now: float, most: int | None = None) -> list[ValueChanged]:
        """The values that have waited long enough, those that have longest first; `most` of them at most."""
        due = self._due
        changes: list[ValueChanged] = []
        while due and due[0][0] <= now and len(changes) != most:
            turn, _, key = heapq.heappop(due)
            limit = self._limits.get(key)
            # Another time: something overtook, and what waits now has an entry of its own.
            if limit is not None and limit.due == turn and (change := limit.pop(now)) is not None:
                changes.append(change)
        return changes

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        return self._due[0][0] if self._due else None

    def forget(self, keys: Iterable[NodeId]) -> None:
        """These nodes are gone."""
        for key in keys:
            self._limits.pop(key, None)
