from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

import pytest

from ua_fleet.bridge import (
    BoundedInlet,
    DriverEvent,
    Dropped,
    ExecutionEnded,
    ExecutionProgressed,
    SampleRead,
    SourceFound,
    SourceLost,
)
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic

TOPIC, OTHER = Topic(2, 2, 1001), Topic(2, 2, 1002)
FOUND, LOST = SourceFound(TOPIC, "t", ()), SourceLost(TOPIC)


class Loop(asyncio.SelectorEventLoop):
    """An event loop that counts how often another thread wakes it."""

    wakes = 0

    def call_soon_threadsafe(self, callback: Callable[..., object], *args: Any, **kwargs: Any) -> asyncio.Handle:  # type: ignore[override]  # the rest is handed on
        self.wakes += 1
        return super().call_soon_threadsafe(callback, *args, **kwargs)


class Bench:
    def __init__(self, size: int = 100, batch: int = 128) -> None:
        self.loop = Loop()
        self.got: list[DriverEvent] = []
        self.inlet = BoundedInlet(self.loop, size, self.got.append, batch)

    def turn(self) -> None:
        """One iteration of the event loop."""
        self.loop.call_soon(self.loop.stop)
        self.loop.run_forever()

    def numbers(self) -> list[Any]:
        return [event.values[0] for event in self.got if isinstance(event, SampleRead)]


@pytest.fixture
def bench() -> Any:
    made: list[Bench] = []

    def make(**kwargs: int) -> Bench:
        made.append(Bench(**kwargs))
        return made[-1]

    yield make
    for one in made:
        one.loop.close()


def sample(number: int, topic: Topic = TOPIC) -> SampleRead:
    return SampleRead(topic, (number,), 0)


def test_events_come_in_their_order_with_one_wake_for_a_batch(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.inlet.open()
    b.turn()
    events: list[DriverEvent] = [FOUND, sample(1), sample(2, OTHER), LOST, FOUND, sample(3)]
    for event in events:
        b.inlet.put(event)
    b.turn()
    assert b.got == events
    assert b.loop.wakes == 1
    b.inlet.put(sample(4))
    b.turn()
    assert b.loop.wakes == 2


def test_events_before_open_wait(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.inlet.put(FOUND)
    b.inlet.put(sample(1))
    b.turn()
    assert b.got == []
    b.inlet.open()
    b.turn()
    assert b.got == [FOUND, sample(1)]
    assert b.loop.wakes == 0


def test_oldest_samples_go_when_full_and_are_counted(bench: Callable[..., Bench]) -> None:
    b = bench(size=3)
    for number in range(10):
        b.inlet.put(sample(number))
    b.inlet.open()
    b.turn()
    assert b.numbers() == [7, 8, 9]
    assert b.got[-1] == Dropped(Drop.INLET_FULL, 7)


def test_facts_are_never_dropped_and_keep_their_place_among_the_samples(bench: Callable[..., Bench]) -> None:
    b = bench(size=2)
    b.inlet.put(FOUND)
    for number in range(5):
        b.inlet.put(sample(number))
    b.inlet.put(LOST)
    b.inlet.put(FOUND)
    b.inlet.put(sample(5))
    b.inlet.open()
    b.turn()
    assert b.got == [FOUND, sample(4), LOST, FOUND, sample(5), Dropped(Drop.INLET_FULL, 4)]


def test_a_batch_is_bounded_so_that_the_loop_gets_its_turn(bench: Callable[..., Bench]) -> None:
    b = bench(batch=4)
    b.inlet.open()
    b.turn()
    for number in range(10):
        b.inlet.put(sample(number))
    counts: list[int] = []
    for _ in range(4):
        b.turn()
        counts.append(len(b.got))
    assert counts == [4, 8, 10, 10]
    assert b.numbers() == list(range(10))
    assert b.loop.wakes == 1


def test_drops_are_summed_up_and_their_details_bounded(bench: Callable[..., Bench]) -> None:
    b = bench()
    for number in range(1000):
        b.inlet.put(Dropped(Drop.CONVERSION, 2, f"field {number}"))
        b.inlet.put(Dropped(Drop.TYPE_MISSING, 1, "p/T"))
    b.inlet.open()
    b.turn()
    drops = [event for event in b.got if isinstance(event, Dropped)]
    assert len(drops) < 100
    assert sum(drop.count for drop in drops if drop.cause is Drop.CONVERSION) == 2000
    assert Dropped(Drop.TYPE_MISSING, 1000, "p/T") in drops


def test_put_after_close_does_nothing_even_when_the_loop_is_closed(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.inlet.open()
    b.turn()
    b.inlet.put(sample(1))
    b.inlet.close()
    b.inlet.put(FOUND)
    b.turn()
    b.loop.close()
    b.inlet.put(sample(2))
    b.inlet.put(Dropped(Drop.CONVERSION))
    assert b.got == []


@pytest.mark.parametrize("batch", [1, 128])
def test_error_of_a_receiver_loses_one_event_alone_and_is_told(bench: Callable[..., Bench], batch: int) -> None:
    b = bench()
    errors: list[dict[str, Any]] = []
    b.loop.set_exception_handler(lambda _, context: errors.append(context))
    fails = [True]

    def deliver(event: DriverEvent) -> None:
        if fails:
            fails.clear()
            raise ValueError("once")
        b.got.append(event)

    inlet = BoundedInlet(b.loop, 10, deliver, batch)
    inlet.open()
    events: list[DriverEvent] = [sample(1), sample(2), ExecutionEnded(b"x" * 16), sample(3)]
    for event in events:
        inlet.put(event)
    for _ in range(5):
        b.turn()
    assert [str(error["exception"]) for error in errors] == ["once"]
    assert errors[0]["message"] == "an event could not be taken in: SampleRead"
    assert b.got == events[1:]


def test_many_threads_lose_nothing(bench: Callable[..., Bench]) -> None:
    b = bench(size=10_000)
    b.inlet.open()

    def feed(space: int) -> None:
        for number in range(500):
            b.inlet.put(sample(number, Topic(space, 2, 1)))

    threads = [threading.Thread(target=feed, args=(space,)) for space in range(2, 6)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads) or len(b.got) < 2000:
        b.turn()
    for thread in threads:
        thread.join()
    for space in range(2, 6):
        mine = [e.values[0] for e in b.got if isinstance(e, SampleRead) and e.topic.space == space]
        assert mine == list(range(500))


def test_ends_of_executions_are_never_dropped_and_progress_is(bench: Callable[..., Bench]) -> None:
    one = bench(size=2)
    execution_id = b"x" * 16
    for number in range(5):
        one.inlet.put(ExecutionProgressed(execution_id, number / 10))
    one.inlet.put(ExecutionEnded(execution_id))
    one.inlet.open()
    one.turn()
    progress = [event.progress for event in one.got if isinstance(event, ExecutionProgressed)]
    assert progress == [0.3, 0.4]
    assert isinstance(one.got[2], ExecutionEnded)
    assert one.got[3] == Dropped(Drop.INLET_FULL, 3)
