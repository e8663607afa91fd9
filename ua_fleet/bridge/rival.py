"""Another process that says it is this bridge: what it sends has our PublisherId, and we have not sent it. Pure.

Two processes of one bridge each journal what they were asked, and each have their robots do it. Neither can know what
the other does, so neither begins anything while both are heard.
"""

from __future__ import annotations

from typing import Final

__all__ = ["RIVAL_S", "Rival"]

RIVAL_S: Final = 5.0
"""So long after its last message another process counts as there. Each second a bridge says something."""
_SAID_AGAIN_S: Final = 60.0


class Rival:
    """Who was heard last, and when."""

    def __init__(self) -> None:
        """Nobody was heard."""
        self._where = ""
        self._heard_at: float | None = None
        self._said_at: float | None = None

    def heard(self, sender: tuple[str, int], now: float) -> None:
        """A message of ours came from another socket than ours."""
        self._where, self._heard_at = f"{sender[0]}:{sender[1]}", now

    def problem(self, now: float) -> str:
        """What is wrong, and what to do; empty while nobody else is heard."""
        if self._heard_at is None or now >= self._heard_at + RIVAL_S:
            return ""
        return (
            f"another process at {self._where} says that it is this bridge, and nothing is begun while both run;"
            f" end one of them"
        )

    def is_due(self, now: float) -> bool:
        """Whether it is to be logged now: at once, then once a minute while it lasts."""
        if not self.problem(now) or (self._said_at is not None and now < self._said_at + _SAID_AGAIN_S):
            return False
        self._said_at = now
        return True
