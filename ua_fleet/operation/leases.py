"""Who holds which robot by this server, and what became of the leases before. Pure; time is an argument.

The bridge grants and ends leases; what stands here follows its word:

    granted                  the bridge has answered to Acquire: the lease is its session's, and nobody else's
    status with its number   it is held
    status with another one  it is over, taken over where somebody has a newer one
    release, departed        this server gives it back

A status that was sent before the grant may come after it. Its counter is not newer than that of the grant; so shortly
after one such a status says nothing of it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from ua_fleet.errors import LeaseRefused
from ua_fleet.teleoperation import Status
from ua_fleet.values import StatusCode

__all__ = ["EndedLease", "HeldLease", "HeldLeases"]

OVERTAKING_S: Final = 0.5
"""So long after a grant a status may come that was sent before it."""
MOST_REMEMBERED: Final = 32
"""Leases of one robot whose end can still be told to who had them."""
_HALF: Final = 0x8000_0000
_ALL: Final = 0xFFFF_FFFF


@dataclass(slots=True, eq=False)
class HeldLease:
    """A lease that a session of this server has."""

    robot: str
    number: int
    session: str
    holder: str
    order: tuple[int, ...]
    """For each axis of the bridge, its place in what clients send."""
    counter: int
    """That of the grant."""
    granted_at: float
    caller: Any = None
    """Who has it, for the audit log."""
    setpoints: int = 0
    """Sent under it."""

    def ordered(self, values: Sequence[float]) -> tuple[float, ...]:
        """The values of a setpoint in the bridge's order; none of another number of them than axes, however many."""
        return tuple([values[place] for place in self.order]) if len(values) == len(self.order) else ()

    def is_older(self, counter: int) -> bool:
        """Whether a counter was published before the lease was granted, or with it."""
        return not 0 < (counter - self.counter) & _ALL < _HALF


class EndedLease(NamedTuple):
    """A lease that is over."""

    lease: HeldLease
    ua_status: int
    """What its holder gets who still uses it."""
    why: str
    """For people; begins with the holder."""


class HeldLeases:
    """The leases of all robots that sessions of one server have, and have had."""

    def __init__(self) -> None:
        self._held: dict[str, HeldLease] = {}
        self._ended: dict[str, OrderedDict[int, EndedLease]] = {}

    def __iter__(self) -> Iterator[HeldLease]:
        return iter(list(self._held.values()))

    def get(self, robot: str) -> HeldLease | None:
        """The lease of a robot."""
        return self._held.get(robot)

    def granted(self, lease: HeldLease) -> EndedLease | None:
        """A session has a lease now; the one of this server that has ended for it."""
        before = self._held.get(lease.robot)
        ended = None
        if before is not None and before.session == lease.session:
            ended = self.end(lease.robot, "acquired again by the same session")
        elif before is not None:
            ended = self.end(lease.robot, f"taken over by {lease.holder}", StatusCode.BAD_RESOURCE_UNAVAILABLE)
        self._held[lease.robot] = lease
        return ended

    def heard(self, robot: str, status: Status, now: float) -> EndedLease | None:
        """The bridge tells of a robot; the lease that is over by that."""
        lease = self._held.get(robot)
        if lease is None or status.lease == lease.number:
            return None
        if status.lease > lease.number:
            return self._end(lease, StatusCode.BAD_RESOURCE_UNAVAILABLE, status.last_end)
        if now < lease.granted_at + OVERTAKING_S and lease.is_older(status.counter):
            return None
        return self._end(lease, StatusCode.BAD_INVALID_STATE, status.last_end)

    def end(self, robot: str, why: str, ua_status: int = StatusCode.BAD_INVALID_STATE) -> EndedLease | None:
        """End the lease of a robot; None where there is none."""
        lease = self._held.get(robot)
        return None if lease is None else self._end(lease, ua_status, f"{lease.holder}: {why}")

    def check(self, robot: str, number: int, session: str) -> HeldLease:
        """The lease with this number, which this session has.

        Raises:
            LeaseRefused: it is over, or another session's, or this server knows nothing of it.
        """
        lease = self._held.get(robot)
        if lease is not None and lease.number == number:
            if lease.session == session:
                return lease
            raise LeaseRefused(StatusCode.BAD_USER_ACCESS_DENIED, f"lease {number} of {robot} is another session's")
        remembered = self._ended.get(robot)
        ended = None if remembered is None else remembered.get(number)
        if ended is not None and ended.lease.session == session:
            raise LeaseRefused(ended.ua_status, f"lease {number} of {robot} is over ({ended.why})")
        raise LeaseRefused(StatusCode.BAD_INVALID_STATE, f"this session has no lease {number} of {robot}")

    def _end(self, lease: HeldLease, ua_status: int, why: str) -> EndedLease:
        del self._held[lease.robot]
        ended = EndedLease(lease, int(ua_status), why or f"{lease.holder}: the bridge was started anew")
        remembered = self._ended.setdefault(lease.robot, OrderedDict())
        remembered[lease.number] = ended
        if len(remembered) > MOST_REMEMBERED:
            remembered.popitem(last=False)
        return ended
