"""Until when a certificate may be shown, and when to say that it ends (OPC 10000-4 6.1.3, Validity Period)."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Final, NamedTuple

__all__ = ["WARN_DAYS", "Reminder", "Validity"]

WARN_DAYS: Final = 30
"""So long before its end a certificate is spoken of, once a day."""
_DAY: Final = timedelta(days=1)


class Validity(NamedTuple):
    """First and last moment of a certificate, with their time zone."""

    begin: datetime
    end: datetime

    def days_left(self, now: datetime) -> int:
        """Whole days until the end; negative once it has expired."""
        return (self.end - now) // _DAY

    def problem(self, now: datetime) -> str:
        """Why it cannot be shown now; the empty text if it can."""
        if now > self.end:
            return f"expired on {self.end:%Y-%m-%d}"
        return f"is valid only from {self.begin:%Y-%m-%d %H:%M} UTC" if now < self.begin else ""

    def notice(self, now: datetime) -> str:
        """What to say of it before it has ended, and after; the empty text while its end is far."""
        problem = self.problem(now)
        if problem or self.end - now >= timedelta(days=WARN_DAYS):
            return problem
        days = self.days_left(now)
        return f"expires on {self.end:%Y-%m-%d}, in {days} day{'' if days == 1 else 's'}"


class Reminder:
    """Says of several certificates what there is to say, of each once a day and whenever it is something else."""

    def __init__(self) -> None:
        self._said: dict[str, tuple[str, datetime]] = {}

    def due(self, name: str, validity: Validity, now: datetime) -> str:
        """The notice of a certificate if it has to be said now, else the empty text."""
        notice = validity.notice(now)
        if not notice:
            self._said.pop(name, None)
            return ""
        before, at = self._said.get(name, ("", now))
        # The days that are left change each day; what began or ended is something else at once.
        if before and now - at < _DAY and before.partition(" ")[0] == notice.partition(" ")[0]:
            return ""
        self._said[name] = notice, now
        return notice
