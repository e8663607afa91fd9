"""Running a command's coroutine until it is done, or until Ctrl-C or SIGTERM."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Coroutine
from typing import Any

__all__ = ["run"]


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
