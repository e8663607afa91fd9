"""Analog values at most so often for each node: the first at once, then the last one of each period, and never none.

Booleans, enumerations, strings and changes of quality pass at once; one that overtakes a waiting value replaces it.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from itertools import count

from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.values import NodeId

__all__ = ["Coalescer"]


class _Node:
    __slots__ = ("free_at", "waiting")

    def __init__(self, free_at: float) -> None:
        self.free_at = free_at
        self.waiting: ValueChanged | None = None


class Coalescer:
    """Holds back analog values that come too fast. `now` is float seconds of any monotonic clock."""

    def __init__(self, rate_hz: float) -> None:
        """Make a coalescer that lets each node's analog value pass `rate_hz` times a second."""
        self._period_s = 1.0 / rate_hz
        self._nodes: dict[NodeId, _Node] = {}
        self._due: list[tuple[float, int, NodeId]] = []
        self._order = count()

    def offer(self, change: ValueChanged, now: float) -> ValueChanged | None:
        """The change if it may be written now; None if it has to wait for `poll`."""
        node = self._nodes.get(change.key)
        if node is None:
            self._nodes[change.key] = _Node(now + self._period_s)
            return change
        if not change.can_wait:
            node.waiting = None
            node.free_at = now + self._period_s
            return change
        if node.waiting is not None:
            node.waiting = change
            return None
        if now >= node.free_at:
            node.free_at = now + self._period_s
            return change
        node.waiting = change
        heapq.heappush(self._due, (node.free_at, next(self._order), change.key))
        return None

    def poll(self, now: float) -> list[ValueChanged]:
        """The values that have waited long enough."""
        due = self._due
        changes: list[ValueChanged] = []
        while due and due[0][0] <= now:
            free_at, _, key = heapq.heappop(due)
            node = self._nodes.get(key)
            # Another time: something overtook, and what waits now has an entry of its own.
            if node is None or node.waiting is None or node.free_at != free_at:
                continue
            changes.append(node.waiting)
            node.waiting = None
            node.free_at = now + self._period_s
        return changes

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        return self._due[0][0] if self._due else None

    def forget(self, keys: Iterable[NodeId]) -> None:
        """These nodes are gone."""
        for key in keys:
            self._nodes.pop(key, None)
