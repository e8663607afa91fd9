"""The Timestamps of one process's messages: they increase, unless the clock that they come from was ahead.

A value that follows one of a later time gets that time and one tick more. Where the last one is ahead of the wall clock
itself, that would go on until the wall clock gets there; the value keeps its own time instead.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from ua_fleet.topics import Topic
from ua_fleet.values import TICKS_PER_SECOND

__all__ = ["MOST_AHEAD_S", "Timestamps"]

MOST_AHEAD_S: Final = 60
"""How far the last Timestamp may be ahead of the wall clock, and of the new one, before that is taken as it is."""
_MOST_AHEAD: Final = MOST_AHEAD_S * TICKS_PER_SECOND


class Timestamps:
    """Says which Timestamp follows another one."""

    def __init__(self, *, only_increase: bool = False) -> None:
        """Know no time.

        Args:
            only_increase: whether a Timestamp that is far ahead is followed all the same. So are those of commands: a
                reader takes what goes back only after its MessageReceiveTimeout.
        """
        self._only_increase = only_increase
        self._wall_offset: int | None = None
        """Ticks of the wall clock at time 0."""
        self.told: Callable[[Topic, float], None] | None = None
        """Told once of a message whose Timestamp went back, and by how many seconds."""

    def set_clock(self, now: float, wall_ticks: int) -> None:
        """Take the time of the wall clock."""
        self._wall_offset = wall_ticks - round(now * TICKS_PER_SECOND)

    def after(self, topic: Topic, last: int, timestamp: int, now: float) -> int:
        """The Timestamp of a message whose time is not later than that of the last one; 0 is no time of its own."""
        back = last - timestamp
        if self._only_increase or self._wall_offset is None or not timestamp or back <= _MOST_AHEAD:
            return last + 1
        if last - self._wall_offset - now * TICKS_PER_SECOND <= _MOST_AHEAD:
            return last + 1  # it is the source that has said something old
        if self.told is not None:
            told, self.told = self.told, None
            told(topic, back / TICKS_PER_SECOND)
        return timestamp
