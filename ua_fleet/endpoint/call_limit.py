"""How often one bridge may ask for keys: pure, time is an argument."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

__all__ = ["CallLimit"]

LEAST_BURST: Final = 120
LEAST_PER_SECOND: Final = 2.0


@dataclass(slots=True)
class _Bucket:
    left: float
    at: float


class CallLimit:
    """A token bucket for each caller; as many callers as there are bridges.

    A bridge asks for each group at its start, and then at half of the KeyLifetime (OPC 10000-14 8.3.2); it may do so
    four times as often. So a bridge that has gone astray can neither keep the server busy nor push older lines out of
    the audit log.
    """

    def __init__(self, groups: int, lifetime_s: float) -> None:
        self._burst = float(max(LEAST_BURST, 4 * groups))
        self._per_second = max(LEAST_PER_SECOND, 8 * groups / lifetime_s)
        self._buckets: dict[str, _Bucket] = {}

    def take(self, caller: str, now: float) -> bool:
        """Whether a caller may ask once more now."""
        bucket = self._buckets.setdefault(caller, _Bucket(self._burst, now))
        bucket.left = min(self._burst, bucket.left + (now - bucket.at) * self._per_second)
        bucket.at = now
        if bucket.left < 1:
            return False
        bucket.left -= 1
        return True
