from __future__ import annotations

import asyncio
from collections.abc import Sequence
from random import Random

from ua_fleet.bridge import BoundedInlet, DriverEvent, Dropped, SampleRead, SourceFound, SourceLost, SourceRead
from ua_fleet.bridge.driver import SourceForgotten
from ua_fleet.bridge.source_facts import MOST_OF_SOURCE, SourceFacts
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic

TOPIC, OTHER = Topic(2, 2, 1001), Topic(2, 2, 1002)


def left(facts: SourceFacts) -> list[DriverEvent]:
    return [facts.pop() for _ in range(len(facts))]


def test_a_source_that_comes_and_goes_without_end_has_a_bound_of_its_own() -> None:
    facts = SourceFacts()
    facts.put(SourceFound(OTHER, "other", ()), 0)
    for number in range(10_000):
        facts.put(SourceFound(TOPIC, str(number), ()), number)
        facts.put(SourceLost(TOPIC), number)
        assert len(facts) <= MOST_OF_SOURCE + 1
    facts.put(SourceForgotten(TOPIC), 10_000)
    told = left(facts)
    assert told[0] == SourceFound(OTHER, "other", ())
    assert told[-2:] == [SourceLost(TOPIC), SourceForgotten(TOPIC)]


def test_of_readings_that_brought_nothing_new_the_last_one_is_told() -> None:
    facts = SourceFacts()
    for number in range(1000):
        facts.put(SourceRead(TOPIC, number), number)
        facts.put(SourceRead(OTHER, number), number)
    assert left(facts) == [SourceRead(TOPIC, 999), SourceRead(OTHER, 999)]


def after(events: Sequence[object]) -> tuple[str | None, int | None]:
    """What is known of the source: its name while it is there, and its last value since then."""
    name: str | None = None
    value: int | None = None
    for event in events:
        if isinstance(event, SourceFound):
            name, value = event.name, None
        elif isinstance(event, SourceLost):
            name = value = None
        elif isinstance(event, SampleRead) and name is not None:
            assert event.values[0] == name, "a sample of another time"
            value = event.source_time_ns
    return name, value


def test_whoever_hears_the_rest_knows_the_same_in_the_end() -> None:
    random, loop = Random(5), asyncio.new_event_loop()
    for _ in range(200):
        got: list[DriverEvent] = []
        told: list[DriverEvent] = []
        inlet = BoundedInlet(loop, 10_000, told.append)
        name: str | None = None
        for number in range(random.randrange(150)):
            event: DriverEvent
            if name is None or random.random() < 0.3:
                name = str(number) if name is None else None
                event = SourceLost(TOPIC) if name is None else SourceFound(TOPIC, name, ())
            else:
                event = SampleRead(TOPIC, (name,), number)
            got.append(event)
            inlet.put(event)
            inlet.put(SampleRead(OTHER, (number,), number))
        inlet.open()
        for _ in range(10):  # 128 events are handed on in a turn
            loop.call_soon(loop.stop)
            loop.run_forever()
        mine = [event for event in told if not isinstance(event, Dropped) and getattr(event, "topic", None) == TOPIC]
        assert after(mine) == after(got)
        lost = sum(event.count for event in told if isinstance(event, Dropped) and event.cause is Drop.INLET_FULL)
        samples = [event for event in got if isinstance(event, SampleRead)]
        assert lost == len(samples) - sum(isinstance(event, SampleRead) for event in mine)
    loop.close()
