"""Saying in time that certificates end: the server's own, those of its bridges and of clients that it trusts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import structlog

from ua_fleet.endpoint.certificates import CertificateInfo, CertificateState, list_certificates
from ua_fleet.validity import Reminder

__all__ = ["CertificateWatch"]

_log: Any = structlog.get_logger("ua_fleet.certificates")

PERIOD_S: Final = 3600.0
"""How often the folders are looked at; each certificate is spoken of once a day at most."""


class CertificateWatch:
    """Called in time (`server.attached.Clock`)."""

    def __init__(
        self,
        state_dir: Path,
        clock: Callable[[], float],
        wall: Callable[[], datetime] = lambda: datetime.now(UTC),
        found: Callable[[Sequence[tuple[CertificateInfo, str]]], None] = lambda _found: None,
    ) -> None:
        """Watch the certificates of a server.

        Args:
            state_dir: the server's.
            clock: seconds that only grow.
            wall: the time of day, by which certificates end.
            found: told of all certificates each time, with what is to be said of each; empty for nothing.
        """
        self._state_dir, self._clock, self._wall, self._found = state_dir, clock, wall, found
        self._reminder = Reminder()
        self._next_at = clock()

    def due_in_s(self) -> float | None:
        """See Clock."""
        return max(self._next_at - self._clock(), 0.0)

    def poll(self) -> None:
        """See Clock."""
        if self._clock() < self._next_at:
            return
        self._next_at = self._clock() + PERIOD_S
        now = self._wall()
        watched = [one for one in list_certificates(self._state_dir) if one.state is not CertificateState.REJECTED]
        self._found([(info, info.validity.notice(now)) for info in watched])
        for info in watched:
            notice = self._reminder.due(str(info.path), info.validity, now)
            if notice:
                named = f"bridge {info.bridge}" if info.bridge else info.gateway and f"gateway {info.gateway}"
                whose = f"the certificate of {named}" if named else "a certificate"
                _log.warning(f"{whose} {notice}", certificate=str(info.path), todo=info.renewal)
