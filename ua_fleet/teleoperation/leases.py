"""Who may drive a robot: one lease at a time, with a number that was never given before. Pure; time is an argument.

    (none)  --acquire-->                    held
    held    --release, silence, stop-->     (none)
    held    --acquire by the same session, or with take_over-->  held by another number

A lease lasts LEASE_S from its grant, from each Renew, and from each setpoint that was taken under it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from ua_fleet.errors import LeaseRefused
from ua_fleet.teleoperation.model import LEASE_S
from ua_fleet.values import StatusCode

__all__ = ["Lease", "Leases"]


class Lease(NamedTuple):
    """The right to drive a robot."""

    number: int
    holder: str
    """Name for people."""
    session: str
    """What it ends with, as its server calls it."""


class Leases:
    """The leases of one robot."""

    def __init__(self, robot: str, next_number: Callable[[], int]) -> None:
        """Begin without one.

        Args:
            robot: its name, for refusals.
            next_number: a number that is greater than all that were given before, in former runs too; raises
                StorageUnavailable where nobody knows one.
        """
        self._robot, self._next_number = robot, next_number
        self._lease: Lease | None = None
        self._until = 0.0
        self.last_end = ""
        """Why the last one ended, a line for people that begins with its holder."""
        self.ends = 0
        """How many have ended."""

    @property
    def held(self) -> Lease | None:
        """The lease that is held."""
        return self._lease

    def grant(self, holder: str, session: str, now: float, *, take_over: bool) -> tuple[Lease, str]:
        """Give a new lease, and say whose ended for it, or "".

        Raises:
            LeaseRefused: another session holds it, and it is not taken over.
            StorageUnavailable: there is no number; nothing has changed.
        """
        before, taken_from = self._lease, ""
        if before is not None and before.session != session:
            if not take_over:
                said = f"{self._robot} is driven by {before.holder}; wait, or have an engineer take it over"
                raise LeaseRefused(StatusCode.BAD_RESOURCE_UNAVAILABLE, said)
            taken_from = before.holder
        lease = Lease(self._next_number(), holder, session)
        if before is not None:
            self.end(f"taken over by {holder}" if taken_from else "acquired again by the same session")
        self._lease, self._until = lease, now + LEASE_S
        return lease, taken_from

    def prolong(self, now: float) -> None:
        """Its holder was heard."""
        self._until = now + LEASE_S

    def check(self, number: int) -> Lease:
        """The lease with this number; LeaseRefused where it is not held."""
        if self._lease is None or self._lease.number != number:
            said = f"lease {number} of {self._robot} is over"
            raise LeaseRefused(StatusCode.BAD_INVALID_STATE, f"{said} ({self.last_end})" if self.last_end else said)
        return self._lease

    def is_silent(self, now: float) -> bool:
        """Whether there is one, of which nothing was heard for too long."""
        return self._lease is not None and now >= self._until

    def end(self, why: str) -> None:
        """There is none any more."""
        if self._lease is not None:
            self.last_end = f"{self._lease.holder}: {why}"
            self.ends += 1
            self._lease = None
