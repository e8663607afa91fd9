"""The timer of the server: between two pieces of what is due, others have their turn."""

from __future__ import annotations

import asyncio
from math import inf

from ua_fleet.server.timer import Timer


async def test_where_there_is_more_to_do_others_have_their_turn_and_it_goes_on() -> None:
    done: list[str] = []
    pieces = iter([True, True, False])
    over = asyncio.Event()

    async def another() -> None:
        while not over.is_set():
            done.append("other")
            await asyncio.sleep(0)

    def poll(_now: float) -> bool:
        done.append("piece")
        has_more = next(pieces)
        if not has_more:
            over.set()
        return has_more

    def deadline(now: float) -> float:
        return inf if over.is_set() else now

    timer = asyncio.ensure_future(Timer().run(poll, deadline))
    await asyncio.sleep(0)
    await another()
    timer.cancel()
    await asyncio.wait([timer])
    begun = done.index("piece")
    assert done[begun : begun + 5] == ["piece", "other", "piece", "other", "piece"]


async def test_it_looks_once_however_often_it_is_told_in_a_turn_of_the_loop() -> None:
    asked, due = 0, inf
    polled = asyncio.Event()

    def deadline(_now: float) -> float:
        nonlocal asked
        asked += 1
        return due

    def poll(_now: float) -> bool:
        nonlocal due
        due = inf
        polled.set()
        return False

    timer = Timer()
    running = asyncio.ensure_future(timer.run(poll, deadline))
    await asyncio.sleep(0)
    asked = 0
    for again in range(2):  # it is woken each time
        due = 0.0
        for _ in range(64):
            timer.sooner()
        assert asked == 2 * again  # a message is taken, and nothing is asked for it
        await asyncio.wait_for(polled.wait(), 60)
        polled.clear()
        await asyncio.sleep(0)
        assert asked == 2 * again + 2  # once to wake it, and once more after the poll
    running.cancel()
    await asyncio.wait([running])
