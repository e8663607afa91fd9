"""How often sources that nobody configured may become other ones. Pure; times are ticks of the wall clock."""

from __future__ import annotations

from typing import Final

from ua_fleet.values import TICKS_PER_SECOND

__all__ = ["MINUTE", "LinePerMinute", "PerMinute"]

MINUTE: Final = 60 * TICKS_PER_SECOND


class PerMinute:
    """So many in a minute, which begins with the first of them."""

    __slots__ = ("_began", "_left", "_most")

    def __init__(self, most: int) -> None:
        self._most = self._left = most
        self._began = -MINUTE

    def take(self, now: int) -> bool:
        """Whether there may be one more now."""
        if not 0 <= now - self._began < MINUTE:  # a clock that was set back begins a new one too
            self._began, self._left = now, self._most
        if not self._left:
            return False
        self._left -= 1
        return True


class LinePerMinute:
    """One line of the log in a minute, with how many there were since the last one."""

    __slots__ = ("_lines", "_unsaid")

    def __init__(self) -> None:
        self._lines, self._unsaid = PerMinute(1), 0

    def say(self, text: str, now: int) -> str:
        """The line, or an empty text where it is only counted."""
        if not self._lines.take(now):
            self._unsaid += 1
            return ""
        unsaid, self._unsaid = self._unsaid, 0
        return f"{text} (and {unsaid} more such changes since the last line)" if unsaid else text
