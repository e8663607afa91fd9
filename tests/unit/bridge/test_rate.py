from __future__ import annotations

import asyncio
import itertools
import threading
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from tests.waiting import until
from ua_fleet.bridge.rate import RateGate, RateLimit, ThreadedGate


def test_first_goes_at_once_and_the_latest_waits_for_its_turn() -> None:
    limit = RateLimit[str](10.0)
    assert limit.offer("a", 0.0) == ("a", False)
    assert limit.offer("b", 0.01) == (None, False)
    assert limit.offer("c", 0.02) == (None, True)
    assert limit.due == 0.1
    assert limit.take(0.09) is None
    assert limit.take(0.1) == "c"
    assert limit.take(0.5) is None


def test_item_that_comes_at_its_turn_replaces_the_one_that_waited() -> None:
    limit = RateLimit[str](10.0)
    limit.offer("a", 0.0)
    limit.offer("b", 0.05)
    assert limit.offer("c", 0.2) == ("c", True)
    assert limit.take(0.9) is None


@given(st.lists(st.floats(min_value=0.0, max_value=1.0), min_size=1, max_size=50), st.floats(0.5, 50.0))
def test_rate_holds_and_the_last_one_always_arrives(gaps: list[float], rate: float) -> None:
    limit = RateLimit[int](rate)
    now, passed = 0.0, list[tuple[float, int]]()
    for number, gap in enumerate(gaps):
        while limit.due is not None and limit.due <= now + gap:
            due = limit.due
            item = limit.take(due)
            assert item is not None
            passed.append((due, item))
        now += gap
        item, _ = limit.offer(number, now)
        if item is not None:
            passed.append((now, item))
    if limit.due is not None:
        item = limit.take(limit.due)
        assert item is not None
        passed.append((now, item))
    assert passed[-1][1] == len(gaps) - 1
    times = [time for time, _ in passed[:-1]]
    assert all(later - earlier >= 1.0 / rate - 1e-9 for earlier, later in itertools.pairwise(times))
    assert [number for _, number in passed] == sorted({number for _, number in passed})


async def test_gate_delivers_the_last_one_when_its_turn_comes() -> None:
    loop = asyncio.get_running_loop()
    delivered = list[int]()
    replaced = list[bool]()
    gate = RateGate[int](200.0, loop, delivered.append, lambda: replaced.append(True))
    for number in range(5):
        gate.offer(number)
    assert delivered == [0]
    while len(delivered) < 2:
        await asyncio.sleep(0)
    assert delivered == [0, 4]
    assert len(replaced) == 3


async def test_gate_is_flushed_when_the_source_goes_and_works_again_after() -> None:
    delivered = list[int]()
    gate = RateGate[int](0.001, asyncio.get_running_loop(), delivered.append, lambda: None)
    gate.offer(1)
    gate.offer(2)
    gate.flush()
    assert delivered == [1, 2]
    gate.flush()
    gate.offer(3)
    gate.close()
    assert delivered == [1, 2]


async def test_a_gate_that_threads_feed_keeps_one_item_however_busy_the_loop_is() -> None:
    """The callback of a ROS 1 topic at 1 kHz must not fill the event loop's own queue."""
    loop, passed, replaced = asyncio.get_running_loop(), list[int](), 0
    scheduled = 0
    real = loop.call_soon_threadsafe

    def count(*arguments: Any, **named: Any) -> Any:
        nonlocal scheduled
        scheduled += 1
        return real(*arguments, **named)

    def count_replaced() -> None:
        nonlocal replaced
        replaced += 1

    loop.call_soon_threadsafe = count  # type: ignore[assignment]
    try:
        gate = ThreadedGate[int](1.0, loop, passed.append, count_replaced)

        def feed() -> None:
            for number in range(1000):
                gate.offer(number)

        thread = threading.Thread(target=feed)
        thread.start()
        thread.join()  # and the loop does nothing meanwhile
    finally:
        del loop.call_soon_threadsafe
    assert (passed, replaced, scheduled) == ([0], 998, 1)
    gate.flush(lambda: passed.append(-1))
    assert passed == [0, 999, -1]


async def test_what_waits_in_such_a_gate_is_handed_on_in_its_turn() -> None:
    passed: list[int] = []
    gate = ThreadedGate[int](2.0, asyncio.get_running_loop(), passed.append, lambda: None)
    for number in range(3):
        gate.offer(number)
    await until(lambda: passed == [0, 2], "the last one")
    gate.offer(3)
    await until(lambda: passed == [0, 2, 3], "the next one")
