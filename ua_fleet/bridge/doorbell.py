"""How other threads wake the event loop: a counter of the kernel's that the loop waits for like for a socket."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable

__all__ = ["Doorbell"]


class Doorbell:
    """Has a function called in the event loop, soon after another thread has rung.

    `call_soon_threadsafe` does the same, and makes a Handle and a copy of the context for it, writes to a socket and
    reads twice from its other end. At two hundred messages a second, each after a pause, all that is executed from cold
    caches.
    """

    __slots__ = ("_answer", "_closing", "_loop", "_number")

    def __init__(self, loop: asyncio.AbstractEventLoop, answer: Callable[[], None]) -> None:
        """Call `answer` in `loop`, once for all rings before it."""
        self._loop, self._answer = loop, answer
        self._closing = threading.Lock()
        """Keeps the number from being closed, and given to another file, while a thread writes to it."""
        self._number = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        loop.add_reader(self._number, self._rung)

    def ring(self) -> None:
        """Wake the loop; callable from any thread. Does nothing once closed."""
        with self._closing:
            if self._number >= 0:
                os.eventfd_write(self._number, 1)

    def _rung(self) -> None:
        os.eventfd_read(self._number)
        self._answer()

    def close(self) -> None:
        """Take it down, in the loop. Safe to call twice."""
        with self._closing:
            if self._number >= 0:
                self._loop.remove_reader(self._number)
                os.close(self._number)
                self._number = -1
