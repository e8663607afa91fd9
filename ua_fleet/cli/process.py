"""Running a command's coroutine until it is done, or until Ctrl-C or SIGTERM; and starting a large one cheaply."""

from __future__ import annotations

import asyncio
import gc
import signal
from collections.abc import Callable, Coroutine, Generator
from contextlib import contextmanager
from typing import Any

__all__ = ["collection_paused", "run"]


def run(main: Coroutine[Any, Any, None]) -> None:
    """Run `main`. A signal cancels it, so that it releases what it holds; then KeyboardInterrupt is raised."""

    async def until_ended() -> None:
        loop, task = asyncio.get_running_loop(), asyncio.current_task()
        assert task is not None
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, task.cancel)
        await main

    try:
        asyncio.run(until_ended())
    except asyncio.CancelledError:
        raise KeyboardInterrupt from None


@contextmanager
def collection_paused() -> Generator[Callable[[], None]]:
    """No garbage collection while a process starts: its objects stay: and it would go through them again and again.

    Yields what is called once the start is over: collection goes on, and never looks at these objects again.
    """

    def settled() -> None:
        gc.freeze()  # some 3,000 objects of garbage with the rest: to look for them in a large fleet takes 0.7 s
        gc.enable()

    gc.disable()
    try:
        yield settled
    finally:
        gc.enable()
