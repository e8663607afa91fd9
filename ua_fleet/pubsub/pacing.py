"""A pace that receivers can follow.

Ten thousand writers that answer a probe, or whose repeats fall due together, must not overrun the receive buffers of
those who listen (212,992 bytes on a stock Linux).
"""

from __future__ import annotations

from typing import Final

from ua_fleet.rate import Budget

__all__ = ["Pace"]

_BYTES_PER_SECOND: Final = 4_000_000
_BURST_BYTES: Final = 96 * 1024
_RESUME_BYTES: Final = 24 * 1024
"""After it is used up, the budget first refills so far: else each datagram would carry one message."""
_DATAGRAM_BYTES: Final = 512
"""What a datagram occupies in a receive buffer besides its payload."""


class Pace:
    """A budget of bytes that refills with time. It may be overdrawn once; then it must refill first."""

    __slots__ = ("_budget", "_needed", "_now")

    def __init__(self) -> None:
        self._budget = Budget(_BYTES_PER_SECOND, _BURST_BYTES)
        self._needed = self._now = 0.0

    def allows(self, now: float) -> bool:
        """Whether something more may be sent now."""
        self._now = max(self._now, now)
        if self._budget.left(self._now) > self._needed - 1.0:  # one less, so that rounding asks for no other round
            self._needed = 0.0
            return True
        return False

    def take(self, size: int, *, datagrams: int = 0) -> None:
        """Count what is sent: bytes, and whole datagrams."""
        self._budget.spend(self._now, size + datagrams * _DATAGRAM_BYTES)
        if self._budget.left(self._now) <= 0:
            self._needed = _RESUME_BYTES

    @property
    def ready_at(self) -> float:
        """The time from which `allows` says yes; in the past where it does already."""
        return self._budget.at(self._needed)
