"""What there is to say about malformed datagrams, without a flood: once for each cause, then at most once a minute."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ua_fleet.errors import RemoteWireError

__all__ = ["Complaint", "Complaints"]

_SILENCE_S: Final = 60.0


@dataclass(frozen=True, slots=True)
class Complaint:
    """Malformed datagrams of one cause, since the last complaint about it."""

    cause: str
    count: int
    detail: str
    """What was wrong with the latest of them."""


class Complaints:
    """Collects what the owner logs. The causes are those of the codec, so there is a bounded number of them."""

    def __init__(self) -> None:
        self._open: dict[str, Complaint] = {}
        self._said_at: dict[str, float] = {}

    def add(self, error: RemoteWireError) -> None:
        """Note a datagram that could not be decoded."""
        cause = error.cause
        before = self._open.get(cause)
        self._open[cause] = Complaint(cause, 1 if before is None else before.count + 1, str(error))

    def take(self, now: float) -> list[Complaint]:
        """What is to be logged now; nothing is returned twice."""
        if not self._open:
            return []
        said_at = self._said_at
        due = [cause for cause in self._open if now - said_at.get(cause, float("-inf")) >= _SILENCE_S]
        for cause in due:
            said_at[cause] = now
        return [self._open.pop(cause) for cause in due]
