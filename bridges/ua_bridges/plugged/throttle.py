"""At most so many values in a second: a burst passes, of a flood the latest, and the last one always. Pure."""

from __future__ import annotations

from typing import Final

from ua_fleet.bridge.driver import SampleRead

__all__ = ["Throttle"]

_ROUNDING: Final = 1e-6


class Throttle:
    """A bucket that fills with `rate_hz`, and holds a second's worth."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz, self._most = rate_hz, max(rate_hz, 1.0)
        self._left, self._at = self._most, 0.0
        self._held: SampleRead | None = None

    def offer(self, sample: SampleRead, now: float) -> tuple[SampleRead | None, int]:
        """A value: it again where it may pass now, and how many it has taken the place of."""
        skipped = 0 if self._held is None else 1
        self._held = sample
        return self.due(now), skipped

    def due(self, now: float) -> SampleRead | None:
        """The value that waits, where its turn has come."""
        if self._held is None:
            return None
        self._left = min(self._most, self._left + (now - self._at) * self._rate_hz)
        self._at = now
        if self._left < 1.0 - _ROUNDING:
            return None
        self._left -= 1.0
        return self.flush()

    def flush(self) -> SampleRead | None:
        """The value that waits, whether its turn has come or not."""
        held, self._held = self._held, None
        return held

    def due_at(self) -> float | None:
        """When the value that waits may pass."""
        return None if self._held is None else self._at + (1.0 - self._left) / self._rate_hz
