"""The one timer of the server: it polls when something is due, and is told when that is sooner than it knew."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from math import inf
from typing import Final

__all__ = ["SHORTEST_WAIT_S", "Timer"]

SHORTEST_WAIT_S: Final = 0.005
"""Deadlines that lie closer together are served together."""


class Timer:
    """Made before what it polls, so that parts of that can wake it."""

    def __init__(self) -> None:
        self._woken = asyncio.Event()
        self._wake_at = -inf
        self._deadline: Callable[[float], float] = lambda _now: inf
        self._is_to_look = False

    def sooner(self) -> None:
        """Wake it where something has to be done before it would wake by itself.

        It looks in the next turn of the event loop, and once for all that came in this one: a broker or a socket brings
        many messages in a turn, and asking all parts when they are due takes as long as taking one of them.
        """
        if not self._is_to_look:
            self._is_to_look = True
            asyncio.get_running_loop().call_soon(self._look)

    def _look(self) -> None:
        self._is_to_look = False
        if self._deadline(asyncio.get_running_loop().time()) < self._wake_at - SHORTEST_WAIT_S:
            self._woken.set()

    async def run(self, poll: Callable[[float], bool], deadline: Callable[[float], float]) -> None:
        """Poll in time until cancelled.

        Args:
            poll: does what is due; where it returns that there is more, others have their turn, and it goes on.
            deadline: when that is next, asked with the time of now.
        """
        self._deadline, loop = deadline, asyncio.get_running_loop()
        while True:
            self._wake_at = max(deadline(loop.time()), loop.time() + SHORTEST_WAIT_S)
            try:
                async with asyncio.timeout_at(self._wake_at):
                    await self._woken.wait()
            except TimeoutError:
                pass
            self._woken.clear()
            while poll(loop.time()):  # noqa: ASYNC110 - others have a turn; there is no event to wait for
                await asyncio.sleep(0)
