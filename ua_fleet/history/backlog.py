"""Rows that wait for the store: bounded, and with a mark where some were lost."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from ua_fleet.history.recorder import Kept
from ua_fleet.history.rows import BAD_DATA_LOST, Row
from ua_fleet.values import NodeId

__all__ = ["Backlog"]


class Backlog:
    """Rows in the order in which they came. What comes while it is full is lost, and counted.

    The oldest stay: a store that was away gets what happened until the memory was full, then marks of what is missing.
    """

    def __init__(self, most: int) -> None:
        """Keep at most so many rows."""
        self._most = most
        self._rows: deque[Kept] = deque()
        self._lost_since: dict[NodeId, int] = {}
        """The time of the first row of a node that was lost."""
        self.lost = 0
        """Rows that were lost since the start."""

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def is_full(self) -> bool:
        """Whether the next row is lost."""
        return len(self._rows) >= self._most

    def add(self, kept: Sequence[Kept]) -> None:
        """Add rows, as far as there is room; before the first one of a node that has lost some comes the mark of it."""
        for key, row in kept:
            if self.is_full:
                self.lost += 1
                self._lost_since.setdefault(key, row.time)
                continue
            since = self._lost_since.pop(key, None)
            if since is not None:
                self._rows.append((key, Row(since, BAD_DATA_LOST, 0, None)))
            self._rows.append((key, row))

    def take(self, most: int) -> list[Kept]:
        """The first rows, for the store."""
        return [self._rows.popleft() for _ in range(min(most, len(self._rows)))]

    def restore(self, batch: Sequence[Kept]) -> None:
        """Put back what the store did not take."""
        self._rows.extendleft(reversed(batch))
