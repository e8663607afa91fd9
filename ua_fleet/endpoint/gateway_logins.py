"""Wrong logins of people behind gateways: they slow down the name that is guessed at, and no other.

A gateway is one client, and one address, for many people. A wrong password counts for its gateway and user name. Names
that no user has are new each time, so that no lock by name holds whoever makes them up: of each gateway they have a
budget of password checks. Time is an argument.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from ua_fleet.endpoint.throttle import LoginThrottle
from ua_fleet.endpoint.users import PasswordLane

__all__ = ["UNKNOWN_AT_ONCE", "UNKNOWN_PER_S", "Attempt", "GatewayLogins", "LoginOutcome"]

UNKNOWN_AT_ONCE: Final = 10
"""Names that no user has which are checked at once for one gateway, as if somebody had them."""
UNKNOWN_PER_S: Final = 1.0
"""Those in the long run: a tenth of a core."""
WAITING: Final = 32
"""Password checks of one gateway that may wait."""
WAITING_OF_NAME: Final = 2
"""Of these, those for one user name."""


class LoginOutcome(StrEnum):
    """What became of a login."""

    ACCEPTED = "accepted"
    WRONG_PASSWORD = "wrong_password"  # noqa: S105 - an outcome
    WRONG_KEY = "wrong_key"
    LOCKED_OUT = "locked_out"
    TOO_BUSY = "too_busy"


@dataclass(frozen=True, slots=True)
class Attempt:
    """A login by a password."""

    gateway: str
    name: str
    is_known: bool
    """Whether there is such a user."""

    @property
    def lane(self) -> PasswordLane:
        """Where its password check waits: names that no user has keep no place from those that one has."""
        lane, places = ("users", WAITING) if self.is_known else ("unknown", UNKNOWN_AT_ONCE)
        return PasswordLane(f"{lane} of gateway {self.gateway}", self.name, places, WAITING_OF_NAME)


@dataclass(slots=True)
class _Budget:
    left: float
    at: float


class GatewayLogins:
    """What is known of the logins through all gateways."""

    def __init__(self) -> None:
        # Apart: however many names are made up, no failure of a user is forgotten for them.
        self._users, self._unknown = (LoginThrottle(as_a_whole=False) for _ in range(2))
        self._budgets: dict[str, _Budget] = {}
        self.outcomes: Counter[tuple[str, LoginOutcome]] = Counter()
        """How many logins of each gateway ended how."""

    def count(self, gateway: str, outcome: LoginOutcome) -> None:
        """A login of a gateway has ended so."""
        self.outcomes[gateway, outcome] += 1

    def locked_for(self, attempt: Attempt, now: float) -> float:
        """Seconds until this name may be tried again through this gateway; 0 when it may now."""
        wait = self._throttle(attempt).locked_for(attempt.gateway, attempt.name, now)
        if wait:
            self.count(attempt.gateway, LoginOutcome.LOCKED_OUT)
        return wait

    def is_flooded(self, gateway: str, now: float) -> bool:
        """Whether no unknown name is checked now."""
        return self._budget(gateway, now).left < 1

    def may_check(self, attempt: Attempt, now: float) -> bool:
        """Whether a password is checked; always for a user, within the gateway's budget for a name that none has."""
        if attempt.is_known:
            return True
        if self.is_flooded(attempt.gateway, now):
            return False
        self._budgets[attempt.gateway].left -= 1
        return True

    def failure(self, attempt: Attempt, now: float) -> None:
        """The password was wrong, or the name."""
        self._throttle(attempt).failure(attempt.gateway, attempt.name, now)

    def success(self, attempt: Attempt) -> None:
        """The password was right: the failures of this name are forgotten."""
        self._throttle(attempt).success(attempt.gateway, attempt.name)
        self.count(attempt.gateway, LoginOutcome.ACCEPTED)

    def _throttle(self, attempt: Attempt) -> LoginThrottle:
        return self._users if attempt.is_known else self._unknown

    def _budget(self, gateway: str, now: float) -> _Budget:
        budget = self._budgets.setdefault(gateway, _Budget(UNKNOWN_AT_ONCE, now))
        budget.left = min(UNKNOWN_AT_ONCE, budget.left + (now - budget.at) * UNKNOWN_PER_S)
        budget.at = now
        return budget
