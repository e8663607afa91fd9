"""Failed logins slow their own source down, and nobody else."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from typing import Final

__all__ = ["LoginThrottle"]

FREE_FAILURES: Final = 5
"""Failures for one user from one address before it is locked out."""
FREE_FAILURES_OF_ADDRESS: Final = 20
"""Failures from one address, whatever the user, before it is locked out."""
FIRST_LOCK_S: Final = 1.0
LONGEST_LOCK_S: Final = 60.0
FORGET_S: Final = 600.0
MAX_SOURCES: Final = 10_000


@dataclass(slots=True)
class _Source:
    failures: int = 0
    locked_until: float = 0.0
    last_failure: float = 0.0


class LoginThrottle:
    """Locks a source out for 1, 2, 4 .. 60 seconds once it has failed too often; time is an argument."""

    def __init__(self, *, as_a_whole: bool = True) -> None:
        """Count failures for an address and for each user at it.

        Args:
            as_a_whole: lock an address out for its failures with all users together; a gateway, which is many people,
                is not, and stands in the place of the address then.
        """
        self._free = (FREE_FAILURES, FREE_FAILURES_OF_ADDRESS)[: 1 + as_a_whole]
        self._sources: OrderedDict[Hashable, _Source] = OrderedDict()
        self.failed = 0
        """Logins with a wrong user or password."""
        self.locked_out = 0
        """Logins refused unseen because their source is locked out."""

    def locked_for(self, address: str, user: str, now: float) -> float:
        """Seconds until this address may try this user again; 0 when it may now."""
        until = max(
            (self._sources[key].locked_until for key, _ in self._keys(address, user) if key in self._sources), default=0
        )
        if until <= now:
            return 0.0
        self.locked_out += 1
        return until - now

    def failure(self, address: str, user: str, now: float) -> None:
        """A login has failed."""
        self.failed += 1
        for key, free in self._keys(address, user):
            source = self._sources.setdefault(key, _Source())
            self._sources.move_to_end(key)
            if now - source.last_failure > FORGET_S:
                source.failures = 0
            source.failures += 1
            source.last_failure = now
            if source.failures >= free:
                lock = FIRST_LOCK_S * 2.0 ** min(source.failures - free, 10)
                source.locked_until = now + min(lock, LONGEST_LOCK_S)
        while len(self._sources) > MAX_SOURCES:
            self._sources.popitem(last=False)

    def success(self, address: str, user: str) -> None:
        """A login has succeeded: this user's failures from this address are forgotten, the address's others are not."""
        self._sources.pop((address, user), None)

    def _keys(self, address: str, user: str) -> Iterator[tuple[Hashable, int]]:
        """What a failure counts for, and how many are free; the address as a whole comes last."""
        return zip(((address, user), address), self._free, strict=False)
