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

    def sooner(self) -> None:
        """Wake it where something has to be done before it would wake by itself."""
        if self._deadline(asyncio.get_running_loop().time()) < self._wake_at - SHORTEST_WAIT_S:
            self._woken.set()

    async def run(self, poll: Callable[[float], None], deadline: Callable[[float], float]) -> None:
        """Poll in time until cancelled; `deadline` is when that is next, asked with the time of now."""
        self._deadline, loop = deadline, asyncio.get_running_loop()
        while True:
            self._wake_at = max(deadline(loop.time()), loop.time() + SHORTEST_WAIT_S)
            try:
                async with asyncio.timeout_at(self._wake_at):
                    await self._woken.wait()
            except TimeoutError:
                pass
            self._woken.clear()
            poll(loop.time())
