"""What the server's parts have to do in time: one timer for all, and each part guarded.

A part that fails is left alone for a second, so that its deadline, which stays in the past, does not wake the others
all the time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import inf
from typing import Final

from ua_fleet.operation.log import MistakeLog

__all__ = ["Entry", "Timetable"]

Entry = tuple[str, Callable[[float], None], Callable[[float], float | None]]
"""A part: the name by which its mistakes are counted; what does what is due, called with `now`, also before its time;
and when that is to be called next, or None, called with `now`."""

PAUSE_S: Final = 1.0
"""A part that has failed is not asked again before that."""


class _Part:
    __slots__ = ("due_at", "name", "not_before", "poll")

    def __init__(self, name: str, poll: Callable[[float], None], due_at: Callable[[float], float | None]) -> None:
        self.name, self.poll, self.due_at = name, poll, due_at
        self.not_before = -inf


class Timetable:
    """Deadlines of parts, and their turns. `now` is float seconds of any monotonic clock."""

    def __init__(self, mistakes: MistakeLog, entries: Iterable[Entry]) -> None:
        self._mistakes = mistakes
        self._parts = [_Part(*entry) for entry in entries]

    def next_deadline(self, now: float) -> float:
        """When `poll` is to be called next; infinity where nothing is due."""
        nearest = inf
        for part in self._parts:
            due: float | None = part.not_before
            if now >= part.not_before:
                try:
                    due = part.due_at(now)
                except Exception as error:  # noqa: BLE001 - costs this part a second, and the others nothing
                    due = self._failed(part, error, now)
            if due is not None and due < nearest:
                nearest = due
        return nearest

    def poll(self, now: float) -> None:
        """Give each part its turn."""
        for part in self._parts:
            if now >= part.not_before:
                try:
                    part.poll(now)
                except Exception as error:  # noqa: BLE001 - as above
                    self._failed(part, error, now)

    def _failed(self, part: _Part, error: Exception, now: float) -> float:
        part.not_before = now + PAUSE_S
        self._mistakes.caught(part.name, error)
        return part.not_before
