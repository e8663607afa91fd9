"""What the console has dropped, refused and got wrong, by cause."""

from __future__ import annotations

from collections import Counter
from typing import Final

from ua_fleet.console.setpoints import SETPOINT_CAUSES
from ua_fleet.monitoring import Mistakes

__all__ = ["DROP_CAUSES", "ConsoleCounts"]

DROP_CAUSES: Final = (
    "wrong_host",
    "wrong_origin",
    "wrong_csrf",
    "not_logged_in",
    "other_user",
    "too_large",
    "too_many_connections",
    "too_slow",
    "invalid",
    "too_many_feeds",
    "too_many_messages",
    "too_many_requests",
    "too_many_sessions",
    "too_many_sockets",
    "login_failed",
    "login_limited",
    "key_not_revoked",
    "too_many_drives",
    "drive_silent",
    "answer_forgotten",
    *SETPOINT_CAUSES,
)
"""All that is counted, so that a counter that is 0 can be seen too."""


class ConsoleCounts:
    """The counters of a console."""

    def __init__(self, mistakes: Mistakes | None = None) -> None:
        self.drops: Counter[str] = Counter(dict.fromkeys(DROP_CAUSES, 0))
        self.mistakes = mistakes or Mistakes()

    def drop(self, cause: str) -> None:
        """Something was dropped or refused."""
        self.drops[cause] += 1

    def mistake(self, where: str, error: BaseException) -> None:
        """A mistake of ours, which has cost one item; its traceback is logged once for each place."""
        self.mistakes.caught(where, error)
