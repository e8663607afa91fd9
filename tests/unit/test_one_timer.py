"""The one timer of a shell, on an event loop that turns by itself."""

from __future__ import annotations

import asyncio
import math

from ua_fleet.one_timer import OneTimer


class Bench:
    """A timer, and the order in which it and markers beside it came."""

    def __init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.now = self.loop.time()
        self.came: list[str] = []
        self.timer = OneTimer(self.loop, lambda: self.came.append("rings"))

    def mark(self, name: str, after_s: float) -> None:
        self.loop.call_at(self.now + after_s, self.came.append, name)

    async def until(self, after_s: float) -> list[str]:
        over = self.loop.create_future()
        self.loop.call_at(self.now + after_s, over.set_result, None)
        await over
        return self.came


async def test_it_is_moved_to_the_front_and_never_back() -> None:
    bench = Bench()
    bench.mark("early", 0.01)
    bench.mark("late", 0.03)
    bench.timer.set(bench.now + 0.04)
    bench.timer.set(bench.now + 0.02)
    bench.timer.set(bench.now + 0.05)
    assert await bench.until(0.06) == ["early", "rings", "late"]


async def test_it_rings_again_once_it_is_set_again() -> None:
    bench = Bench()
    bench.timer.set(bench.now)
    assert await bench.until(0.01) == ["rings"]
    bench.timer.set(bench.now)
    assert await bench.until(0.02) == ["rings", "rings"]


async def test_what_has_failed_waits() -> None:
    bench = Bench()
    bench.mark("before", 0.01)
    bench.timer.pause(bench.now + 0.02)
    bench.timer.set(bench.now)
    assert await bench.until(0.03) == ["before", "rings"]


async def test_it_is_silent_without_a_deadline() -> None:
    bench = Bench()
    bench.timer.set(math.inf)
    assert await bench.until(0.01) == []


async def test_it_never_rings_after_its_end() -> None:
    bench = Bench()
    bench.timer.set(bench.now + 0.01)
    bench.timer.end()
    bench.timer.set(bench.now)
    assert await bench.until(0.02) == []
