"""The one timer of a shell: it rings at the next deadline of what the shell drives."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from typing import Final

__all__ = ["PAUSE_S", "OneTimer"]

PAUSE_S: Final = 1.0
"""What was due and has failed is tried again after so long."""


class OneTimer:
    """One timer in an event loop, which is moved and never doubled."""

    def __init__(self, loop: asyncio.AbstractEventLoop, ring: Callable[[], None]) -> None:
        self._loop, self._ring = loop, ring
        self._handle: asyncio.TimerHandle | None = None
        self._not_before = -math.inf
        self._is_over = False

    def set(self, at: float) -> None:
        """Ring at `at`, in seconds of the loop's clock, unless it rings before that; infinity: leave it as it is."""
        at = max(at, self._not_before)
        if self._is_over or at == math.inf or (self._handle is not None and self._handle.when() <= at):
            return
        self._cancel()
        self._handle = self._loop.call_at(at, self._rings)

    def pause(self, until: float) -> None:
        """What was due has failed, and stays due: do not ring before `until`, and not all the time."""
        self._not_before = until

    def end(self) -> None:
        """Never ring again, whatever still comes from sockets and threads while all is being closed."""
        self._is_over = True
        self._cancel()

    def _cancel(self) -> None:
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def _rings(self) -> None:
        self._handle = None
        self._ring()
