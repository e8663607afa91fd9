"""Which browsers are logged in, and until when. Pure: time is an argument, in seconds of a clock that never goes back.

The cookie's token is kept as its hash alone: what is read out of the console's memory or logs opens nothing.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final

from ua_fleet.console.repeats import KeptAnswers

__all__ = ["BrowserSession", "BrowserSessions", "cookie_name"]

_TOKEN_BYTES: Final = 32


def cookie_name(certificate: bytes, port: int) -> str:
    """The name of a console's cookie.

    Browsers tell neither ports apart nor the containers behind them, so that two consoles of a host need two names:
    those of one certificate differ by their ports, those of one port, as in containers, by their certificates.
    """
    return f"ua-fleet-console-{hashlib.sha256(certificate + port.to_bytes(2)).hexdigest()[:12]}"


@dataclass(eq=False, slots=True)
class BrowserSession:
    """A browser that is logged in, at one fleet or more."""

    token_hash: str = field(repr=False)
    csrf: str = field(repr=False)
    began_s: float
    used_s: float
    """When a person last did something."""
    logins: dict[str, Any] = field(default_factory=dict[str, Any])
    """By fleet: the link that it is logged in by."""
    sockets: int = 0
    answers: KeptAnswers = field(default_factory=KeptAnswers)
    """To commands of which a page may not have received the answer."""

    def is_csrf(self, given: str) -> bool:
        """Whether this is its token against forged requests."""
        return hmac.compare_digest(given.encode(), self.csrf.encode())


class BrowserSessions:
    """All browsers that are logged in."""

    def __init__(self, idle_s: float, longest_s: float, most: int) -> None:
        self._idle_s, self._longest_s, self._most = idle_s, longest_s, most
        self._all: dict[str, BrowserSession] = {}

    def __len__(self) -> int:
        return len(self._all)

    def __iter__(self) -> Iterator[BrowserSession]:
        return iter(list(self._all.values()))

    @property
    def is_full(self) -> bool:
        """Whether no further one can begin."""
        return len(self._all) >= self._most

    def begin(self, now: float) -> tuple[BrowserSession, str] | None:
        """A new session and the token of its cookie; None where there are too many."""
        if self.is_full:
            return None
        token = secrets.token_urlsafe(_TOKEN_BYTES)
        session = BrowserSession(_hash(token), secrets.token_urlsafe(_TOKEN_BYTES), now, now)
        self._all[session.token_hash] = session
        return session, token

    def find(self, token: str, now: float) -> BrowserSession | None:
        """The session of a cookie; None where there is none, or it is over."""
        session = self._all.get(_hash(token))
        return None if session is None or self.is_over(session, now) else session

    def use(self, session: BrowserSession, now: float) -> None:
        """A person has done something."""
        session.used_s = now

    def ends_s(self, session: BrowserSession) -> float:
        """When it is over unless it is used."""
        return min(session.began_s + self._longest_s, session.used_s + self._idle_s)

    def is_over(self, session: BrowserSession, now: float) -> bool:
        """Whether its time is over, or it has ended."""
        return now >= self.ends_s(session) or session.token_hash not in self._all

    def end(self, session: BrowserSession) -> None:
        """It is over."""
        self._all.pop(session.token_hash, None)

    def expired(self, now: float) -> list[BrowserSession]:
        """Those whose time is over."""
        return [session for session in self._all.values() if now >= self.ends_s(session)]


def _hash(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()
