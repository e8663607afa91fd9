"""Mistakes of ours that cost one item of a loop: counted, logged once with their traceback, and shown.

A loop that serves many guards each item, so that what is wrong with one (a datagram, a change, a robot, a timer) keeps
nothing else from its turn:

    with mistakes.guard("projection"):
        await self._apply(change)

and a task that must not end is run by `keep`. What is expected to fail (a peer that is away, a journal that cannot be
written) has errors and counters of its own, and is no mistake.
"""

from __future__ import annotations

import asyncio
import traceback
from collections import Counter
from collections.abc import Awaitable, Callable
from types import TracebackType
from typing import Any, Final

import structlog

__all__ = ["Mistakes", "is_cancelled"]

MOST_TOLD: Final = 256
"""Different mistakes that the log names; all are counted."""
MOST_TEXT: Final = 200
"""Characters of the last one that are shown."""
PAUSE_S: Final = 1.0
"""Before a task that has failed is run again."""

_log: Any = structlog.get_logger("ua_fleet.mistakes")


class Mistakes:
    """The mistakes of one process since its start."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        """By the loop in which they were caught; its names are words of the code."""
        self.last = ""
        """The last one, in one line; empty where there was none."""
        self._told: set[tuple[str, str, str]] = set()

    @property
    def count(self) -> int:
        """All of them."""
        return self.counts.total()

    def caught(self, loop: str, error: BaseException, **ids: object) -> None:
        """Count a mistake that cost one item, and log it where it is the first of its kind.

        Args:
            loop: whose item it was.
            error: what was raised.
            ids: what the item was about, as the log names it.
        """
        place = self.counted(loop, error)
        kind = (loop, type(error).__name__, place)
        if kind in self._told or len(self._told) >= MOST_TOLD:
            return
        self._told.add(kind)
        _log.error("a mistake cost one item; what follows goes on", loop=loop, exc_info=error, **ids)

    def counted(self, loop: str, error: BaseException) -> str:
        """Count a mistake that the log has already; the line that raised."""
        self.counts[loop] += 1
        place = _place_of(error)
        text = " ".join(f"{type(error).__name__}: {error}".split())
        self.last = f"{loop}: {text[:MOST_TEXT]} ({place})"
        return place

    def guard(self, loop: str, **ids: object) -> _Guard:
        """A context whose exceptions cost what stands in it and no more; arguments as of `caught`."""
        return _Guard(self, loop, ids)

    async def keep(self, loop: str, work: Callable[[], Awaitable[None]]) -> None:
        """Run what must not end before it is cancelled: again after a pause, where a mistake has ended it."""
        while True:
            try:
                await work()
            except Exception as error:  # counted; the work begins again
                if is_cancelled():
                    raise  # it fails because it is ended, and is not to begin again
                self.caught(loop, error)
            else:
                return
            await asyncio.sleep(PAUSE_S)

    def in_loop(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """The exception handler of an event loop: what a callback raises that has no guard of its own."""
        error = context.get("exception")
        if isinstance(error, Exception):
            self.caught("callback", error, detail=context.get("message", ""))
        else:
            loop.default_exception_handler(context)

    def text(self) -> str:
        """One line for people; empty where there was none."""
        count = self.count
        if not count:
            return ""
        return f"{count} mistake{'s' if count > 1 else ''} since the start, see the log; the last one in {self.last}"


def is_cancelled() -> bool:
    """Whether the task that asks is being cancelled: what it raises now is the end of it."""
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0


class _Guard:
    __slots__ = ("_ids", "_loop", "_mistakes")

    def __init__(self, mistakes: Mistakes, loop: str, ids: dict[str, object]) -> None:
        self._mistakes, self._loop, self._ids = mistakes, loop, ids

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if not isinstance(error, Exception):
            return False  # the end of the task or of the process is not ours to stop
        self._mistakes.caught(self._loop, error, **self._ids)
        return True


def _place_of(error: BaseException) -> str:
    """The line that raised."""
    if error.__traceback__ is None:
        return "no traceback"
    frame = traceback.extract_tb(error.__traceback__, limit=-1)[0]
    return f"{frame.filename.rpartition('/')[2]}:{frame.lineno}"
