"""MessageNonces that never repeat for a key (OPC 10000-14 7.2.4.4.3.2, table 156).

    2 bytes  the sender's space      several members of one group never make the same nonce,
    2 bytes  random for each start   nor do, as far as chance allows, two processes that were given the same space
    4 bytes  sequence number         from 1 for each SecurityGroup and token, little endian

AES-CTR with one nonce used twice for a key gives both messages away, so the numbers are reserved in blocks, on disk
before the first of a block is used. A process that was killed loses the rest of its block and goes on with the next
one: what its readers hear is newer than anything before, and so fits a strict replay window.
"""

from __future__ import annotations

from struct import Struct
from typing import Final, Protocol

from ua_fleet.errors import UaFleetError
from ua_fleet.printing import config_option
from ua_fleet.pubsub.security.replay import PAGE

__all__ = [
    "BLOCK",
    "LAST_NUMBER",
    "MemoryNonces",
    "NonceReservations",
    "NonceSequence",
    "NoncesUnavailable",
    "nonce_prefix",
]

BLOCK: Final = PAGE
"""Numbers reserved at once, as many as a page of a reader's window: at 1,000 messages a second a write to the disk each
minute."""
LAST_NUMBER: Final = 3 << 30
"""The last number that is used with a key: for readers that compare numbers as 7.2.3 does, the first ones would begin
to look newer again."""
MARGIN: Final = 8_192
"""The next block is reserved while so many numbers are left, so that a disk may fail for a while."""
RETRY_S: Final = 1.0
"""A reservation that failed is tried again after so long."""

_PREFIX: Final = Struct("<HH")
_NUMBER: Final = Struct("<I")


class NoncesUnavailable(UaFleetError):
    """There is no nonce to send with; says why and what to do about it."""

    remedy = "Give the process a `state_dir` on a disk that it can write."


class NonceReservations(Protocol):
    """Gives blocks of sequence numbers, each number once."""

    def reserve(self, group_id: str, token_id: int, count: int) -> int:
        """The first of `count` numbers that were never given before for this group and token.

        They are higher than all before, and durably marked as given before this returns.

        Raises:
            NoncesUnavailable: it could not be written down; nothing was given.
        """
        ...


class MemoryNonces:
    """Reservations that a restart forgets: only for keys that nobody has sent with, or for who never sends.

    A process without a disk has to be given a new token after each start.
    """

    def __init__(self) -> None:
        self._next: dict[tuple[str, int], int] = {}

    def reserve(self, group_id: str, token_id: int, count: int) -> int:
        """See NonceReservations."""
        first = self._next.get((group_id, token_id), 1)
        self._next[group_id, token_id] = first + count
        return first


def nonce_prefix(space: int, random_16_bits: int) -> bytes:
    """The first half of a process's nonces."""
    return _PREFIX.pack(space, random_16_bits)


class NonceSequence:
    """The nonces of one process for one key."""

    __slots__ = (
        "_ahead",
        "_end",
        "_failure",
        "_group_id",
        "_next",
        "_prefix",
        "_reservations",
        "_reserve_at",
        "_retry_at",
        "token_id",
    )

    def __init__(self, reservations: NonceReservations, group_id: str, token_id: int, prefix: bytes) -> None:
        self._reservations = reservations
        self.token_id = token_id
        self._group_id, self._prefix = group_id, prefix
        self._next = 1
        self._end = 1
        """Numbers before it may be used."""
        self._reserve_at = 1
        """From this number on the next block is asked for."""
        self._ahead: int | None = None
        """The first number of the next block, once that is reserved."""
        self._failure: NoncesUnavailable | None = None
        self._retry_at = float("-inf")

    def next(self, now: float) -> bytes:
        """A nonce that was never used with this key; raises NoncesUnavailable."""
        number = self._next
        if number >= self._reserve_at:
            number = self._refill(now)
        self._next = number + 1
        return self._prefix + _NUMBER.pack(number)

    def _refill(self, now: float) -> int:
        """The next number, after reserving a block where one is due; a failure counts only when all are used up."""
        is_empty = self._next >= self._end
        if self._ahead is None:
            if now >= self._retry_at:
                try:
                    self._ahead, self._failure = self._reserve(), None
                except NoncesUnavailable as error:
                    self._failure, self._retry_at = error, now + RETRY_S
            if self._failure is not None:
                if is_empty:
                    raise self._failure
                return self._next
        assert self._ahead is not None
        if not is_empty:
            self._reserve_at = self._end
            return self._next
        first, self._ahead = self._ahead, None
        self._end = min(first + BLOCK, LAST_NUMBER + 1)
        self._reserve_at = self._end - MARGIN
        return first

    def _reserve(self) -> int:
        first = self._reservations.reserve(self._group_id, self.token_id, BLOCK)
        if first > LAST_NUMBER:
            raise NoncesUnavailable(
                f"the nonces of token {self.token_id} of {self._group_id} are used up; make new keys: "
                f"ua-fleet keys rotate {self._group_id}{config_option()}"
            )
        return first
