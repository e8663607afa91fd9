from __future__ import annotations

import asyncio
import threading
from typing import Any

from tests.waiting import until
from ua_fleet.bridge.gate import RateGate


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
        gate = RateGate[int](1.0, loop, passed.append, count_replaced)

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
    gate = RateGate[int](2.0, asyncio.get_running_loop(), passed.append, lambda: None)
    for number in range(3):
        gate.offer(number)
    await until(lambda: passed == [0, 2], "the last one")
    gate.offer(3)
    await until(lambda: passed == [0, 2, 3], "the next one")
