"""What asyncua has as coroutines, and what waits for nothing here: it is done when it is called."""

from __future__ import annotations

import asyncio
import types
from collections.abc import Awaitable, Coroutine, Generator
from typing import Any, Final, TypeVar

__all__ = ["DONE", "Done", "do_at_once", "within"]

T = TypeVar("T")


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


async def within(seconds: float, work: Coroutine[Any, Any, T]) -> T:
    """What a coroutine returns; a timer is set only for one that waits for something, which few do.

    Raises:
        TimeoutError: it waits for longer than that.
    """
    try:
        waited = work.send(None)
    except StopIteration as done:
        result: T = done.value
        return result
    async with asyncio.timeout(seconds):
        return await _rest(work, waited)


@types.coroutine
def _rest(work: Coroutine[Any, Any, T], waited: Any) -> Generator[Any, Any, T]:
    """What is left of a coroutine that has begun, and waits."""
    while True:
        try:
            given = yield waited
        except GeneratorExit:
            work.close()
            raise
        except BaseException as error:  # noqa: BLE001 - it is for the coroutine to see
            thrown: BaseException | None = error
            given = None
        else:
            thrown = None
        try:
            waited = work.send(given) if thrown is None else work.throw(thrown)
        except StopIteration as done:
            result: T = done.value
            return result
