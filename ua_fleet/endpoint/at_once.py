"""What asyncua has as coroutines, and what waits for nothing here: it is done when it is called."""

from __future__ import annotations

from collections.abc import Awaitable, Generator
from typing import Final

__all__ = ["DONE", "Done", "do_at_once"]


class Done:
    """What an awaited callback returns when its work is done already."""

    __slots__ = ()

    def __await__(self) -> Generator[None, None, None]:
        return
        yield


DONE: Final = Done()


def do_at_once(work: Awaitable[object]) -> None:
    """Do what an awaitable has to do.

    Raises:
        RuntimeError: it waits for something, which is a mistake of the program.
    """
    if work is DONE:
        return
    for _ in work.__await__():
        raise RuntimeError(f"{work!r} waits, where everything is done at once")
