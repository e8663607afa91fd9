"""Turns: a request that takes long lets the other connections have theirs, and one that is large waits for its user's.

Of each user one large request is worked on at a time, from its decoding until the client has taken the answer. So what
a user can make the server hold does not grow with the number of connections.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Final, Literal
from weakref import WeakValueDictionary

from ua_fleet.endpoint.stack import Refusal

__all__ = ["LARGE_BYTES", "TURN_S", "Places", "TurnPlace", "Turns"]

TURN_S: Final = 0.002
"""Longest time that one request is worked on before the event loop goes round; an operation is never cut in two."""
LARGE_BYTES: Final = 256 * 1024
"""A request, or an answer, of more than that is large."""


class TurnPlace(asyncio.Lock):
    """The place of one user."""

    waiting = 0
    """How many wait for it."""

    async def acquire(self) -> Literal[True]:
        """Wait for it."""
        self.waiting += 1
        try:
            return await super().acquire()
        finally:
            self.waiting -= 1


class Places:
    """One place for each user, who is a name, or an address where clients have none."""

    def __init__(self) -> None:
        self._places: WeakValueDictionary[str, TurnPlace] = WeakValueDictionary()

    def of(self, user: str) -> TurnPlace:
        """The place of a user."""
        place = self._places.get(user)
        if place is None:
            place = self._places[user] = TurnPlace()
        return place


class Turns:
    """The turns of one request. What is done between two of them may be changed by others at each end.

    Args:
        place: of the user.
        refusal: why this request is not to go on; None while it is.
    """

    __slots__ = ("_began", "_place", "_refusal", "is_large")

    def __init__(self, place: TurnPlace, refusal: Callable[[], Refusal | None] = lambda: None) -> None:
        self._place, self._refusal = place, refusal
        self._began = time.monotonic()
        self.is_large = False
        """Whether this request has its user's place."""

    @property
    def over(self) -> bool:
        """Whether it is another's turn."""
        return time.monotonic() - self._began > TURN_S

    def is_due(self, size: int) -> bool:
        """Whether `end` has anything to do."""
        return (size > LARGE_BYTES and not self.is_large) or self.over

    async def end(self, size: int = 0) -> None:
        """Let others have theirs if this one is over; wait for the user's place where `size` bytes are large.

        Raises:
            Refusal: the request is not to go on.
        """
        if size > LARGE_BYTES and not self.is_large:
            await self._place.acquire()
            self.is_large = True
        elif not self.over:
            return
        else:
            await asyncio.sleep(0)
        if (refusal := self._refusal()) is not None:
            raise refusal
        self._began = time.monotonic()

    @property
    def contended(self) -> bool:
        """Whether others wait for what this request has."""
        return self.is_large and self._place.waiting > 0

    def leave(self) -> None:
        """Give the user's place to another request."""
        if self.is_large:
            self.is_large = False
            self._place.release()
