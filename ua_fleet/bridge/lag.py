"""How long messages of the robot side are on their way through a bridge, from the callback to the wire. Pure."""

from __future__ import annotations

from bisect import bisect_left
from typing import Final

__all__ = ["MOST_LAG_S", "LagMeter"]

MOST_LAG_S: Final = 1.0
"""A bridge whose messages take longer is not ready: what it sends is not of now."""
_SHORTEST_S: Final = 0.0005
_STEP: Final = 1.2
_BOUNDS: Final = tuple(_SHORTEST_S * _STEP**step for step in range(64))
"""To 48 s, each a fifth more than the one before: so exact is what is told."""
_WINDOW_S: Final = 1.0
_WINDOWS: Final = 10


class LagMeter:
    """The lags of the last 10 s. A measurement costs 0.3 us, and the memory is bounded."""

    __slots__ = ("_counts", "_ends_at", "_now")

    def __init__(self) -> None:
        self._counts = [[0] * (len(_BOUNDS) + 1) for _ in range(_WINDOWS)]
        """For each of the last seconds, how many lags stood below each bound."""
        self._now = 0
        self._ends_at = float("-inf")

    def observe(self, lag_s: float, now: float) -> None:
        """A message was so long on its way."""
        if now >= self._ends_at:
            self._turn(now)
        self._counts[self._now][bisect_left(_BOUNDS, lag_s)] += 1

    def p99_s(self, now: float) -> float:
        """What 99 of 100 messages of the last 10 s needed at most; 0 where there were none."""
        if now >= self._ends_at:
            self._turn(now)
        counts = [sum(column) for column in zip(*self._counts, strict=True)]
        left = sum(counts)
        if not left:
            return 0.0
        most_above = left // 100
        for bound, count in zip((*_BOUNDS, _BOUNDS[-1] * _STEP)[::-1], counts[::-1], strict=True):
            most_above -= count
            if most_above < 0:
                return bound
        raise AssertionError("there is a lag below some bound")

    def _turn(self, now: float) -> None:
        """Begin a new second, and forget those that are over."""
        over = _WINDOWS if self._ends_at + _WINDOWS * _WINDOW_S <= now else int((now - self._ends_at) / _WINDOW_S) + 1
        for _ in range(min(over, _WINDOWS)):
            self._now = (self._now + 1) % _WINDOWS
            self._counts[self._now] = [0] * (len(_BOUNDS) + 1)
        self._ends_at = now + _WINDOW_S if over >= _WINDOWS else self._ends_at + over * _WINDOW_S
