"""Rows that wait for the store: bounded in number and in bytes, and with a mark where some were lost."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Mapping, Sequence
from enum import StrEnum
from typing import Final, NamedTuple

from ua_fleet.history.recorder import Kept
from ua_fleet.history.rows import BAD_DATA_LOST, Row, value_bytes
from ua_fleet.values import NodeId

__all__ = ["Backlog", "Batch", "Full", "row_bytes"]

_ROW_BYTES: Final = 250
"""Of a row with a number, in memory."""


class Full(StrEnum):
    """Why a row is lost."""

    ROWS = "lost_rows"
    """So many rows wait."""
    BYTES = "lost_bytes"
    """They take so many bytes."""


class Batch(NamedTuple):
    """Rows that the store is to take at once."""

    rows: list[Kept]
    size: int
    """Their bytes."""


class Backlog:
    """Rows in the order in which they came. What comes while it is full is lost, and counted by its cause.

    The oldest stay: a store that was away gets what happened until the memory was full, then marks of what is missing.
    Rows that the store has been given count until it has taken them.
    """

    def __init__(self, most: int, most_bytes: int) -> None:
        """Keep at most so many rows, of so many bytes."""
        self._most, self._most_bytes = most, most_bytes
        self._rows: deque[Kept] = deque()
        self._lost_since: dict[NodeId, int] = {}
        """The time of the first row of a node that was lost."""
        self._waiting_bytes = 0
        self._given = Batch([], 0)
        """What the store has been given."""
        self.lost: Counter[Full] = Counter()
        """Rows that were lost since the start."""

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def untaken(self) -> int:
        """Rows that the store has not taken yet, with those that it has been given."""
        return len(self._rows) + len(self._given.rows)

    @property
    def size(self) -> int:
        """Bytes of all rows that the store has not taken yet."""
        return self._waiting_bytes + self._given.size

    def of(self, keys: Collection[NodeId]) -> list[Row]:
        """What waits of some nodes and the store was not given, with the marks of what is missing."""
        waiting = [row for key, row in self._rows if key in keys]
        return waiting + [_mark_of(since) for key, since in self._lost_since.items() if key in keys]

    def add(self, kept: Sequence[Kept], *, gives_way: bool = False) -> None:
        """Add rows, as far as there is room; before the first one of a node that has lost some comes the mark of it.

        Args:
            kept: the rows.
            gives_way: whether they are to leave half of the room to others.
        """
        for key, row in kept:
            size = row_bytes(row)
            if (cause := self._full(size, 2 if gives_way else 1)) is not None:
                self.lost[cause] += 1
                self._lost_since.setdefault(key, row.time)
                continue
            if key in self._lost_since:
                self._mark(key)
            self._append(key, row, size)

    def take(self) -> Batch:
        """All rows, for the store; then `taken` or `restore` follows."""
        self._given = Batch(list(self._rows), self._waiting_bytes)
        self._rows.clear()
        self._waiting_bytes = 0
        return self._given

    def taken(self) -> list[NodeId]:
        """The store has them. Now that there is room, what was lost is marked, so that a kill does not hide it.

        Returns:
            The nodes with such a mark at their end: what they have now follows.
        """
        self._given = Batch([], 0)
        return self.mark_gaps()

    def restore(self) -> None:
        """Put back what the store did not take."""
        self._rows.extendleft(reversed(self._given.rows))
        self._waiting_bytes += self._given.size
        self._given = Batch([], 0)

    def put_behind(self, stored: Mapping[NodeId, int], stopped_at: int, started_at: int) -> dict[NodeId, int]:
        """Have all rows later than what a store has that was not known when they came.

        Args:
            stored: the time of the last row of each node that it has.
            stopped_at: when the last process that wrote to it was last alive; from then on there is a gap.
            started_at: when this process began: where a row has a time at which the store has one already.

        Returns:
            The time of the last row of each node that waits.
        """
        rows, last = list(self._rows), dict[NodeId, int]()
        self._rows.clear()
        self._waiting_bytes = 0
        for key, row in rows:
            time = row.time
            if key not in last and (before := stored.get(key)) is not None:
                time = time if time > before else max(started_at, before + 1)
                if (at := max(before + 1, stopped_at)) < time:
                    self._append(key, _mark_of(at), _ROW_BYTES)
            last[key] = max(time, last.get(key, -1) + 1)
            self._append(key, row._replace(time=last[key]), row_bytes(row))
        for key, since in self._lost_since.items():  # the marks of what was lost are rows that wait, too
            if key not in last and (before := stored.get(key)) is not None:
                since = max(before + 1, min(since, stopped_at))
            last[key] = self._lost_since[key] = max(since, last.get(key, -1) + 1)
        return last

    def mark_gaps(self) -> list[NodeId]:
        """Add the marks of what was lost, one for each node, whether there is room or not: no row may come to do it.

        Returns:
            These nodes.
        """
        keys = list(self._lost_since)
        for key in keys:
            self._mark(key)
        return keys

    def _full(self, size: int, part: int) -> Full | None:
        """Why a row of so many bytes has no room in such a part of it."""
        if self.untaken * part >= self._most:
            return Full.ROWS
        return Full.BYTES if (self.size + size) * part > self._most_bytes else None

    def _mark(self, key: NodeId) -> None:
        self._append(key, _mark_of(self._lost_since.pop(key)), _ROW_BYTES)

    def _append(self, key: NodeId, row: Row, size: int) -> None:
        self._rows.append((key, row))
        self._waiting_bytes += size


def _mark_of(since: int) -> Row:
    return Row(since, BAD_DATA_LOST, 0, None)


def row_bytes(row: Row) -> int:
    """What a row takes in memory, about."""
    return _ROW_BYTES + value_bytes(row.value)
