"""What there is to say about datagrams that were not taken, without a flood.

Once for each cause, then at most once a minute.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ua_fleet.errors import RemoteWireError
from ua_fleet.pubsub.security.refused import Refused

__all__ = ["Complaint", "Complaints"]

_SILENCE_S: Final = 60.0


@dataclass(frozen=True, slots=True)
class Complaint:
    """Datagrams that were not taken for one cause, since the last complaint about it."""

    cause: str
    count: int
    detail: str
    """What was wrong with the latest of them, and of those that were refused what to do about it."""
    is_refused: bool = False
    """Refused for their security, in place of malformed."""

    @property
    def what(self) -> str:
        """What the log calls them."""
        return "refused messages" if self.is_refused else "malformed datagrams"


class Complaints:
    """Collects what the owner logs. There are as many causes as the codec and the counters have, so it is bounded."""

    def __init__(self) -> None:
        self._open: dict[str, Complaint] = {}
        self._said_at: dict[str, float] = {}

    def add(self, error: RemoteWireError) -> None:
        """Note a datagram that could not be decoded or was refused."""
        cause = error.cause
        before = self._open.get(cause)
        count = 1 if before is None else before.count + 1
        self._open[cause] = Complaint(cause, count, str(error), isinstance(error, Refused))

    def take(self, now: float) -> list[Complaint]:
        """What is to be logged now; nothing is returned twice."""
        if not self._open:
            return []
        said_at = self._said_at
        due = [cause for cause in self._open if now - said_at.get(cause, float("-inf")) >= _SILENCE_S]
        for cause in due:
            said_at[cause] = now
        return [self._open.pop(cause) for cause in due]
