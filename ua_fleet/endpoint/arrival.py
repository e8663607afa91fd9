"""What one task waits for again and again, and with which it goes on at once.

A task that waits for a Future goes on in the next turn of the event loop, which asks the system for news before: that
is a tenth of what a small request costs. Here it goes on within the callback that brings what it waits for. It is a
Future as far as a task needs one.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator
from contextvars import Context
from typing import Any

__all__ = ["Arrival"]


class Arrival:
    """Awaited by one task at a time."""

    _asyncio_future_blocking = False
    """By this asyncio knows what a task may wait for."""

    def __init__(self) -> None:
        """Nobody waits yet."""
        self._loop = asyncio.get_running_loop()
        self._go_on: Callable[[Any], object] | None = None
        self._context: Context | None = None
        self._is_cancelled = False

    def get_loop(self) -> asyncio.AbstractEventLoop:
        """The loop of the task."""
        return self._loop

    def add_done_callback(self, go_on: Callable[[Any], object], *, context: Context) -> None:
        """The task waits, and goes on by this."""
        self._go_on, self._context = go_on, context

    def cancel(self, msg: object = None) -> bool:
        """The task is cancelled: it goes on soon, by an error."""
        if self._go_on is None:
            return False
        self._is_cancelled = True
        self.soon()
        return True

    def result(self) -> None:
        """What the task goes on with."""
        if self._is_cancelled:
            self._is_cancelled = False
            raise asyncio.CancelledError

    def now(self) -> None:
        """The task goes on at once, if it waits; in the next turn where another task calls this."""
        if asyncio.current_task(self._loop) is not None:
            self.soon()
        elif (go_on := self._go_on) is not None:
            self._go_on, context = None, self._context
            assert context is not None
            context.run(go_on, self)

    def soon(self) -> None:
        """The task goes on in the next turn, if it waits."""
        if (go_on := self._go_on) is not None:
            self._go_on = None
            self._loop.call_soon(go_on, self, context=self._context)

    def __await__(self) -> Generator[Any, None, None]:
        """Wait."""
        self._asyncio_future_blocking = True
        yield self
        self.result()
