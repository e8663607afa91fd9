from __future__ import annotations

import asyncio
import os
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
    ExecutionSuspended,
    SampleRead,
    SourceFound,
    SourceLost,
)
from ua_fleet.bridge.lag import LagMeter
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic

TOPIC, OTHER = Topic(2, 2, 1001), Topic(2, 2, 1002)
FOUND, LOST = SourceFound(TOPIC, "t", ()), SourceLost(TOPIC)


class Bench:
    def __init__(self, size: int = 100, batch: int = 128) -> None:
        self.loop = asyncio.SelectorEventLoop()
        self.wakes = 0
        self.got: list[DriverEvent] = []
        self.inlet = BoundedInlet(self.loop, size, self.got.append, batch, clock=lambda: 0.0)  # no turn is too long

    def turn(self) -> None:
        """One iteration of the event loop."""
        self.loop.call_soon(self.loop.stop)
        self.loop.run_forever()

    def numbers(self) -> list[Any]:
        return [event.values[0] for event in self.got if isinstance(event, SampleRead)]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Any:
    made: list[Bench] = []
    write = os.eventfd_write

    def make(**kwargs: int) -> Bench:
        made.append(Bench(**kwargs))
        return made[-1]

    def counted(number: int, value: int) -> None:
        made[-1].wakes += 1
        write(number, value)

    monkeypatch.setattr(os, "eventfd_write", counted)
    yield make
    for one in made:
        one.inlet.close()
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
    assert b.wakes == 1
    b.inlet.put(sample(4))
    b.turn()
    assert b.wakes == 2


def test_events_before_open_wait(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.inlet.put(FOUND)
    b.inlet.put(sample(1))
    b.turn()
    assert b.got == []
    b.inlet.open()
    b.turn()
    assert b.got == [FOUND, sample(1)]
    assert b.wakes == 0


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
    assert b.wakes == 1


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
    assert errors[0]["message"] == "an event could not be taken in: ExecutionEnded"
    assert b.got == [events[0], events[1], events[3]]


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


X, Y = b"x" * 16, b"y" * 16


def test_ends_of_executions_are_never_dropped_and_progress_gives_way_to_newer_progress(
    bench: Callable[..., Bench],
) -> None:
    one = bench(size=2)
    events: list[DriverEvent] = [ExecutionProgressed(X, number / 10) for number in range(5)]
    events += [ExecutionProgressed(Y, 0.9), ExecutionSuspended(X), ExecutionProgressed(X, 0.5), ExecutionEnded(X)]
    for event in events:
        one.inlet.put(event)
    one.inlet.open()
    one.turn()
    assert one.got == [*events[5:], Dropped(Drop.RATE_LIMITED, 5)]
    one.inlet.put(ExecutionProgressed(Y, 1.0))
    one.inlet.put(ExecutionEnded(Y))
    one.turn()
    assert one.got[-2:] == [ExecutionProgressed(Y, 1.0), ExecutionEnded(Y)]


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def waiting_inlet(b: Bench, clock: Clock, **kwargs: Any) -> BoundedInlet:
    inlet = BoundedInlet(b.loop, 10_000, b.got.append, clock=clock, **kwargs)
    inlet.open()
    b.turn()
    return inlet


def test_facts_of_executions_go_before_all_samples(bench: Callable[..., Bench]) -> None:
    b = bench()
    inlet = waiting_inlet(b, Clock())
    for number in range(1000):
        inlet.put(sample(number))
    inlet.put(ExecutionProgressed(X, 0.0))
    inlet.put(ExecutionEnded(Y))
    b.turn()
    assert b.got[:2] == [ExecutionProgressed(X, 0.0), ExecutionEnded(Y)]


def test_a_fact_that_comes_while_samples_are_handed_on_waits_for_one_of_them_alone(bench: Callable[..., Bench]) -> None:
    b = bench()

    def deliver(event: DriverEvent) -> None:
        b.got.append(event)
        if len(b.got) == 3:
            inlet.put(ExecutionEnded(X))

    inlet = BoundedInlet(b.loop, 100, deliver)
    for number in range(10):
        inlet.put(sample(number))
    inlet.open()
    b.turn()
    assert b.got[3] == ExecutionEnded(X)


def test_a_turn_is_bounded_in_time_too(bench: Callable[..., Bench]) -> None:
    b, clock = bench(), Clock()

    def deliver(event: DriverEvent) -> None:
        b.got.append(event)
        clock.now += 0.003

    inlet = BoundedInlet(b.loop, 100, deliver, clock=clock)
    for number in range(5):
        inlet.put(sample(number))
    inlet.open()
    b.turn()
    assert b.numbers() == [0, 1]
    b.turn()
    assert b.numbers() == [0, 1, 2, 3]


def test_before_an_end_goes_what_its_robot_has_said_and_nothing_else(bench: Callable[..., Bench]) -> None:
    b = bench()
    inlet = waiting_inlet(b, Clock(), sources_of={X: {TOPIC}}.get)
    events = [sample(1), sample(2, OTHER), sample(3)]
    for event in events:
        inlet.put(event)
    inlet.put(ExecutionEnded(X))
    b.turn()
    assert b.got == [sample(1), sample(3), ExecutionEnded(X), sample(2, OTHER)]
    assert inlet.waiting == 0


def both_sources(_execution_id: bytes) -> set[Topic]:
    """Whichever execution ends, its robot has both."""
    return {TOPIC, OTHER}


def test_of_many_samples_before_an_end_the_newest_of_each_source_goes(bench: Callable[..., Bench]) -> None:
    b = bench()
    inlet = waiting_inlet(b, Clock(), sources_of=both_sources)
    for number in range(100):
        inlet.put(sample(number, OTHER if number % 10 == 0 else TOPIC))
    inlet.put(ExecutionEnded(X))
    inlet.put(sample(100))
    b.turn()
    assert b.got == [sample(90, OTHER), sample(100), ExecutionEnded(X), Dropped(Drop.TOO_OLD, 99)]


def test_a_large_sample_and_one_of_a_source_that_is_told_of_keep_their_place(bench: Callable[..., Bench]) -> None:
    b = bench()
    inlet = waiting_inlet(b, Clock(), sources_of=both_sources)
    large = SampleRead(OTHER, (bytes(5000),), 0)
    events: list[DriverEvent] = [large, FOUND, sample(1)]
    for event in events:
        inlet.put(event)
    inlet.put(ExecutionEnded(X))
    b.turn()
    assert b.got == [ExecutionEnded(X), *events]


def test_what_has_waited_too_long_goes_where_a_newer_one_waits(bench: Callable[..., Bench]) -> None:
    b, clock = bench(), Clock()
    lag = LagMeter()
    inlet = BoundedInlet(b.loop, 100, b.got.append, max_wait_s=2.0, lag=lag, clock=clock)
    inlet.put(sample(1))
    inlet.put(sample(2))
    inlet.put(sample(3, OTHER))
    clock.now += 1.5
    inlet.put(sample(4)._replace(waited_s=0.9))
    assert inlet.oldest_s() == 1.5
    clock.now += 1.2
    inlet.put(sample(5))
    inlet.open()
    b.turn()
    assert [event for event in b.got if isinstance(event, SampleRead)] == [
        sample(3, OTHER),  # the last one of its source, however old
        sample(5),
    ]
    assert b.got[-1] == Dropped(Drop.TOO_OLD, 3)
    assert lag.p99_s(clock.now) == pytest.approx(2.7, rel=0.2)
    assert (inlet.waiting, inlet.oldest_s()) == (0, 0.0)


def test_a_source_s_own_maximum_age_counts_where_it_is_shorter(bench: Callable[..., Bench]) -> None:
    b, clock = bench(), Clock()
    inlet = BoundedInlet(b.loop, 100, b.got.append, max_wait_s=2.0, max_ages={TOPIC: 0.5, OTHER: 60.0}, clock=clock)
    for number in (1, 2):
        inlet.put(sample(number))
        inlet.put(sample(number, OTHER))
    clock.now += 0.6
    inlet.put(sample(3))
    inlet.open()
    b.turn()
    assert b.got == [sample(1, OTHER), sample(2, OTHER), sample(3), Dropped(Drop.TOO_OLD, 2)]
    for number in (4, 5):
        inlet.put(sample(number, OTHER))
    clock.now += 2.1
    b.turn()
    assert b.got[4:] == [sample(5, OTHER), Dropped(Drop.TOO_OLD, 1)]


def test_a_driver_that_floods_keeps_no_fact_back_by_more_than_one_sample(bench: Callable[..., Bench]) -> None:
    """Ten seconds of a robot's flood in virtual time: each sample costs more than the time until the next one comes."""
    b, clock = bench(), Clock()
    sent_between: dict[bytes, int] = {}

    def deliver(event: DriverEvent) -> None:
        b.got.append(event)
        if not isinstance(event, SampleRead):
            return
        clock.now += 0.010
        for name in sent_between.keys() - told():
            sent_between[name] += 1
        for number in range(2):
            inlet.put(sample(number))
        if len(b.got) % 100 == 50:
            execution_id = len(sent_between).to_bytes(16, "big")
            sent_between[execution_id] = 0
            inlet.put(ExecutionProgressed(execution_id))
            inlet.put(ExecutionEnded(execution_id))

    def told() -> set[bytes]:
        return {event.execution_id for event in b.got if isinstance(event, ExecutionEnded)}

    inlet = BoundedInlet(b.loop, 10_000, deliver, max_wait_s=2.0, clock=clock, sources_of=lambda _id: {TOPIC})
    inlet.put(sample(0))
    inlet.open()
    while clock.now < 110.0:
        b.turn()
    assert len(sent_between) >= 8
    assert max(sent_between.values()) <= 1
    assert inlet.oldest_s() <= 2.3


def test_facts_of_executions_without_end_leave_the_event_loop_its_turns() -> None:
    loop = asyncio.new_event_loop()
    now = 0.0
    got: list[DriverEvent] = []

    def deliver(event: DriverEvent) -> None:  # each takes a while, and the robot says two more meanwhile
        nonlocal now
        now += 0.001
        got.append(event)
        if isinstance(event, ExecutionSuspended) and len(got) < 1000:
            inlet.put(ExecutionProgressed(b"1", 0.5))
            inlet.put(ExecutionSuspended(b"1"))

    inlet = BoundedInlet(loop, 100, deliver, clock=lambda: now)
    inlet.put(ExecutionSuspended(b"1"))
    inlet.put(sample(7))
    inlet.open()
    loop.call_soon(loop.stop)
    loop.run_forever()
    assert len(got) < 10
    assert sample(7) in got, "and a sample comes through in each turn"
    while len(got) < 1000:
        loop.call_soon(loop.stop)
        loop.run_forever()
    loop.close()
