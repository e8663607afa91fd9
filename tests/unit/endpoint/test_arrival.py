"""What a task waits for again and again: it goes on within the callback, and ends as any other when it is cancelled."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from contextvars import Context, ContextVar, copy_context
from typing import Any

import pytest

from ua_fleet.endpoint.arrival import Arrival

pytestmark = pytest.mark.asyncio

WHO: ContextVar[str] = ContextVar("who", default="nobody")


class Waiting:
    """A task that notes how often it went on, and as whom."""

    def __init__(self) -> None:
        self.arrival, self.seen = Arrival(), list[str]()
        self.task = asyncio.create_task(self._wait(), context=_context("the task"))

    async def _wait(self) -> None:
        while True:
            await self.arrival
            assert asyncio.current_task() is self.task
            self.seen.append(WHO.get())


def _context(who: str) -> Context:
    context = copy_context()
    context.run(WHO.set, who)
    return context


async def by_the_loop(call: Any) -> None:
    """Have the event loop call it, and not this task."""
    asyncio.get_running_loop().call_soon(call)
    await asyncio.sleep(0)


async def test_it_goes_on_within_the_callback_and_in_its_own_context() -> None:
    waiting, seen = Waiting(), list[list[str]]()
    await asyncio.sleep(0)

    def arrives() -> None:
        for _ in range(2):
            waiting.arrival.now()
            seen.append(waiting.seen[:])

    await by_the_loop(arrives)
    assert seen == [["the task"], ["the task", "the task"]]
    waiting.task.cancel()


async def test_within_another_task_it_goes_on_in_the_next_turn() -> None:
    waiting = Waiting()
    await asyncio.sleep(0)
    waiting.arrival.now()
    assert not waiting.seen
    await asyncio.sleep(0)
    assert waiting.seen == ["the task"]
    waiting.arrival.soon()
    waiting.arrival.soon()
    assert len(waiting.seen) == 1
    await asyncio.sleep(0)
    assert len(waiting.seen) == 2
    waiting.task.cancel()


async def test_what_comes_while_nobody_waits_is_forgotten() -> None:
    arrival = Arrival()
    arrival.now()
    arrival.soon()
    assert not arrival.cancel()

    async def wait() -> None:
        await arrival

    task = asyncio.create_task(wait())
    await asyncio.sleep(0.01)
    assert not task.done()
    task.cancel()


async def test_a_task_that_waits_can_be_cancelled_and_the_next_one_waits() -> None:
    waiting = Waiting()
    await asyncio.sleep(0)
    waiting.task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting.task
    await by_the_loop(waiting.arrival.now)
    assert not waiting.seen

    async def wait() -> str:
        await waiting.arrival
        return "went on"

    task = asyncio.create_task(wait())
    await asyncio.sleep(0)
    await by_the_loop(waiting.arrival.now)
    assert await task == "went on"


@pytest.mark.parametrize("is_due_first", [True, False])
async def test_a_time_limit_ends_it(is_due_first: bool) -> None:
    arrival = Arrival()

    async def wait() -> str:
        try:
            async with asyncio.timeout(0.01):
                await arrival
        except TimeoutError:
            return "late"
        return "in time"

    task: asyncio.Task[str] = asyncio.create_task(_run(wait()))
    await asyncio.sleep(0)
    if not is_due_first:
        await by_the_loop(arrival.now)
    assert await task == ("late" if is_due_first else "in time")


async def _run(what: Coroutine[Any, Any, str]) -> str:
    return await what


async def test_an_error_of_the_task_is_the_task_s() -> None:
    arrival = Arrival()

    async def fail() -> None:
        await arrival
        raise ValueError("its own")

    task = asyncio.create_task(fail())
    await asyncio.sleep(0)
    await by_the_loop(arrival.now)
    with pytest.raises(ValueError, match="its own"):
        await task
