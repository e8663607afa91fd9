"""When things are due, each known by a key."""

from __future__ import annotations

import heapq
from collections.abc import Hashable, Iterator
from itertools import count
from typing import Generic, TypeVar

__all__ = ["DueTimes"]

Key = TypeVar("Key", bound=Hashable)


class DueTimes(Generic[Key]):
    """One due time for each key; what is due first is found without a search."""

    def __init__(self) -> None:
        self._due: dict[Key, float] = {}
        self._heap: list[tuple[float, int, Key]] = []
        """Of each entry, also those that were replaced or removed: these are passed over when their time comes."""
        self._order = count()

    def __iter__(self) -> Iterator[Key]:
        return iter(self._due)

    def get(self, key: Key) -> float | None:
        """When a key is due, or None."""
        return self._due.get(key)

    def put(self, key: Key, due: float) -> None:
        """Make a key due at a time, and no longer at the one before."""
        self._due[key] = due
        heapq.heappush(self._heap, (due, next(self._order), key))

    def discard(self, key: Key) -> None:
        """Make a key due no more."""
        self._due.pop(key, None)

    def clear(self) -> None:
        """Forget all."""
        self._due.clear()
        self._heap.clear()

    def next(self) -> float | None:
        """When the first key is due, or None."""
        while self._heap and self._due.get(self._heap[0][2]) != self._heap[0][0]:
            heapq.heappop(self._heap)
        return self._heap[0][0] if self._heap else None

    def is_due(self, now: float) -> bool:
        """Whether any key is due."""
        due = self.next()
        return due is not None and due <= now

    def pop(self) -> Key:
        """The first key, which is due no more; KeyError where there is none."""
        if self.next() is None:
            raise KeyError
        key = heapq.heappop(self._heap)[2]
        del self._due[key]
        return key
