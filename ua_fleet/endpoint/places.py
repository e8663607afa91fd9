"""Who gets a place for an active session: so many by user, some kept for engineers and bridges, detached ones go first.

Of the detached ones those without subscriptions go before all others and give way to everybody: their client loses
nothing by logging in anew, so that clients that were killed keep nobody out.

Of the reserved places a fifth is kept for engineers against bridges too: whoever has the certificates of bridges keeps
nobody out who can take them away.

A session is detached while its connection is lost and its client may come back to it. One that has its connection
never gives way.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, Generic, TypeVar

from ua_fleet.endpoint.limits import EndpointLimits
from ua_fleet.endpoint.origin import origin
from ua_fleet.endpoint.users import Role, User

__all__ = ["Holder", "NoPlace", "SessionPlaces", "Standing", "holder_of", "standing_of"]

MOST_OF_BRIDGE: Final = 3
"""Sessions of one bridge: it uses one, and may leave another behind that is not known to be dead yet."""

Key = TypeVar("Key", bound=Hashable)


class Standing(IntEnum):
    """Which places a user may take; each may take those of the ones before it."""

    ORDINARY = 0
    BRIDGE = 1
    ENGINEER = 2


class NoPlace(Exception):
    """There is no place; the text says why."""


@dataclass(frozen=True, slots=True)
class Holder(Generic[Key]):
    """An active session as a holder of a place."""

    key: Key
    owner: Hashable
    standing: Standing
    detached_at: float | None = None
    """When its connection was lost; None while it has one."""
    subscribes: bool = True
    """Whether it has subscriptions, which its client would miss."""

    @property
    def is_left(self) -> bool:
        """Whether it has neither a connection nor subscriptions."""
        return self.detached_at is not None and not self.subscribes


def holder_of(user: User, address: str) -> Hashable:
    """Whom a session counts for: its user, or an anonymous client's address."""
    return (user.name, origin(address)) if user.anonymous else user.name


def standing_of(user: User) -> Standing:
    """Which places are for this user."""
    if user.bridge:
        return Standing.BRIDGE
    return Standing.ENGINEER if user.role.covers(Role.ENGINEER) else Standing.ORDINARY


class SessionPlaces:
    """Decides about the place of one more active session."""

    def __init__(self, limits: EndpointLimits) -> None:
        self._most, self._most_of_one = limits.sessions, limits.sessions_per_user
        reserved = min(limits.reserved_sessions, limits.sessions // 2)
        self._open = limits.sessions - reserved
        self._but_engineers = limits.sessions - (reserved + 4) // 5

    def has_room(self, held: int) -> bool:
        """Whether nothing has to end for one more, whoever holds the places that are taken."""
        return held < min(self._most_of_one, MOST_OF_BRIDGE, self._open, self._but_engineers, self._most)

    def make_room(self, held: Sequence[Holder[Key]], owner: Hashable, standing: Standing) -> list[Key]:
        """The detached sessions that have to end for one more; raises NoPlace.

        Args:
            held: all places that are taken.
            owner: whom the new session counts for.
            standing: which places it may take.
        """
        ending: list[Key] = []
        own = [each for each in held if each.owner == owner]
        is_bridge = standing is Standing.BRIDGE
        if len(own) >= (min(self._most_of_one, MOST_OF_BRIDGE) if is_bridge else self._most_of_one):
            limit = f"of {MOST_OF_BRIDGE}" if is_bridge else "server.max_sessions_per_user"
            ending.append(_longest_detached(own, f"this user has {len(own)} sessions, {limit}"))
        left = [each for each in held if each.key not in ending]
        ordinary = [each for each in left if each.standing is Standing.ORDINARY]
        others = [each for each in left if each.standing is not Standing.ENGINEER]
        if standing is Standing.ORDINARY and len(ordinary) >= self._open:
            reason = f"{len(ordinary)} sessions; {self._most - self._open} of server.max_sessions are reserved"
            ending.append(_longest_detached(ordinary, reason))
        elif standing is not Standing.ENGINEER and len(others) >= self._but_engineers:
            reason = (
                f"{len(others)} sessions; {self._most - self._but_engineers} of server.max_sessions are for engineers"
            )
            ending.append(_longest_detached(_first_to_go(standing, ordinary, others), reason))
        elif len(left) >= self._most:
            reason = f"{len(left)} sessions, server.max_sessions"
            ending.append(_longest_detached(_first_to_go(standing, ordinary, others, left), reason))
        return ending


def _first_to_go(standing: Standing, *groups: Sequence[Holder[Key]]) -> Sequence[Holder[Key]]:
    """Those without connection and subscriptions, or the first group in which somebody is detached.

    The groups are those below the newcomer and its own, the last one has all that count.
    """
    if left := [each for each in groups[-1] if each.is_left]:
        return left
    may = groups[: standing + 1]
    return next((group for group in may if any(each.detached_at is not None for each in group)), may[-1])


def _longest_detached(held: Sequence[Holder[Key]], reason: str) -> Key:
    """The detached session that goes first.

    One without subscriptions, of who holds most places, and there the one without its client longest.
    """
    detached = [(each.detached_at, each) for each in held if each.detached_at is not None]
    if not detached:
        raise NoPlace(reason)
    count = Counter(each.owner for each in held)
    return min(detached, key=lambda item: (item[1].subscribes, -count[item[1].owner], item[0]))[1].key
