"""Which reasons of drops are logged: each once in an hour, and of many different ones so many. Pure."""

from __future__ import annotations

from typing import Final

from ua_fleet.counters import Drop

__all__ = ["MOST_TOLD", "ToldReasons"]

MOST_TOLD: Final = 256
"""Different reasons within the time that they are remembered; the counters of all others go on."""
REMEMBERED_S: Final = 3600.0


class ToldReasons:
    """The reasons that were told in the last hour, the oldest first."""

    def __init__(self) -> None:
        self._told: dict[tuple[Drop, str], float] = {}

    def is_due(self, cause: Drop, detail: str, now: float) -> bool:
        """Whether to tell this reason now; it counts as told then.

        Args:
            cause: what the drop is counted as.
            detail: the reason.
            now: seconds of a monotonic clock.
        """
        while self._told and now >= self._told[oldest := next(iter(self._told))] + REMEMBERED_S:
            del self._told[oldest]
        if (cause, detail) in self._told or len(self._told) >= MOST_TOLD:
            return False
        self._told[cause, detail] = now
        return True
