"""Who gives way when too many connections are without a user: the greediest address, never one that has a user.

Connections without an activated session are of two kinds, and each kind has its own places, so that bare connections
push nobody out who has shown a trusted certificate:

    newcomer      connected, said Hello, or opened a channel on which no session can be made
    progressed    opened a channel on which sessions can be made, or made a session

Both are kinds of their own for gateways, each of which is many people: newcomers from addresses at which a gateway is
connected, and connections that have proved to be a gateway's, where who tries to log in counts, and not the address.

In each kind the network with the most connections gives way (/16, then
/24, then address; of IPv6 /32, /48 and /64), with the connection that came least far, and of these the oldest.
Activated sessions are not counted by address: behind a gateway many clients share one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Hashable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Generic, TypeVar

from ua_fleet.endpoint.origin import networks

__all__ = ["Admission", "Progress", "Waiting", "who_gives_way"]

Key = TypeVar("Key", bound=Hashable)


class Progress(IntEnum):
    """How far a connection has come before it has a user."""

    CONNECTED = 0
    HELLO = 1
    DISCOVERY = 2
    """A channel without security, on which no session can be made."""
    TRUSTED = 3
    """A channel on which sessions can be made."""
    SESSION = 4
    """A session that is not activated."""


@dataclass(frozen=True, slots=True)
class Waiting(Generic[Key]):
    """A connection without an activated session."""

    key: Key
    address: str
    """Whom it counts for."""
    progress: Progress
    opened_at: float
    is_gateways: bool = False
    """Whether it is a gateway's, or has just come from an address at which one is connected."""


def who_gives_way(waiting: Sequence[Waiting[Key]]) -> Key:
    """Of connections that are too many, the one to close; there is at least one."""
    held = Counter(name for each in waiting for name in set(networks(each.address)))

    def rank(each: Waiting[Key]) -> tuple[int, ...]:
        own, network, wide = networks(each.address)
        # One with many addresses has them of one network; where all are of one, its addresses are compared.
        return -held[wide], -held[network], -held[own], each.progress

    return min(waiting, key=lambda each: (*rank(each), each.opened_at)).key


class Admission:
    """Decides what has to give way to a new connection."""

    def __init__(self, most_connections: int) -> None:
        """Share the places out.

        Args:
            most_connections: of all clients together, those with a user too.
        """
        self._most = most_connections
        self._places = max(1, most_connections // 4)

    def has_room(self, connections: int) -> bool:
        """Whether nothing has to give way to a new one, whoever the others are."""
        return connections < min(self._places, self._most)

    def make_room(
        self, waiting: Collection[Waiting[Key]], connections: int, *, beside_gateway: bool = False
    ) -> tuple[list[Key], bool]:
        """What to close for a new connection, and whether it may stay then.

        Args:
            waiting: those without an activated session.
            connections: all that there are.
            beside_gateway: whether a gateway is connected at the address of the new one.
        """
        newcomers, beside, progressed, of_gateways = (
            [each for each in waiting if each.is_gateways is is_gateways and (each.progress >= Progress.TRUSTED) is far]
            for far in (False, True)
            for is_gateways in (False, True)
        )
        closing: list[Key] = []

        def close_one(among: list[Waiting[Key]]) -> None:
            key = who_gives_way(among)
            among[:] = [each for each in among if each.key != key]
            closing.append(key)

        coming = ((newcomers, not beside_gateway), (beside, beside_gateway), (progressed, False), (of_gateways, False))
        for kind, more in coming:
            while len(kind) + more > self._places:
                close_one(kind)
        if connections - len(closing) >= self._most and (among := newcomers or beside or progressed or of_gateways):
            close_one(among)
        return closing, connections - len(closing) < self._most
