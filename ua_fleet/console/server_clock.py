"""How far a server's clock is ahead of the console's: what the server says until when must not hang on other clocks."""

from __future__ import annotations

from collections import deque
from datetime import UTC, datetime
from typing import Any, Final

__all__ = ["ServerClock"]

_SAMPLES: Final = 10
_LEAST_S: Final = 0.5
"""Less is no difference: it comes from how long an answer took."""


class ServerClock:
    """The clock of one server, by its CurrentTime.

    Most servers renew CurrentTime once a second, so what is read is up to a second behind: of the last samples the one
    that is furthest ahead counts.
    """

    def __init__(self) -> None:
        self._samples: deque[float] = deque(maxlen=_SAMPLES)
        self.ahead_s = 0.0
        """Seconds; negative: it is behind."""

    def take(self, told: Any, at: datetime) -> bool:
        """Take what the server has said its time is, and the console's time then; whether `ahead_s` is another."""
        if not isinstance(told, datetime):
            return False
        moment = told if told.tzinfo is not None else told.replace(tzinfo=UTC)
        self._samples.append((moment - at).total_seconds())
        ahead_s = max(self._samples)
        if abs(ahead_s) < _LEAST_S:
            ahead_s = 0.0
        if abs(ahead_s - self.ahead_s) < _LEAST_S:
            return False
        self.ahead_s = round(ahead_s, 1)
        return True
