"""The contract of `ua_fleet.bridge.driver.Driver`."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from tests.contract.harness import NUMBER, TEXT, TWIST, UNKNOWN, Kind, Recorder, Space, broken, message_of
from tests.waiting import until
from ua_fleet.bridge import Driver, SampleRead, SourceFound
from ua_fleet.counters import Drop
from ua_fleet.pubsub.metadata import field_property
from ua_fleet.topics import Topic

OTHER_SPACE = 77
FOREIGN = Topic(OTHER_SPACE, 2, 1001)


@asynccontextmanager
async def started(driver: Driver) -> AsyncGenerator[Recorder]:
    recorder = Recorder()
    await driver.start(recorder)
    try:
        yield recorder
    finally:
        await driver.stop()


def source(space: Space, id: int = 1001) -> Topic:
    return Topic(space.number, 2, id)


async def talk(space: Space, recorder: Recorder, topic: Topic, kind: Kind, *values: Any) -> None:
    """Publish until the driver hears it: the first messages may go before the two have met."""
    before = len(recorder.samples(topic))
    deadline = time.monotonic() + 20
    while len(recorder.samples(topic)) == before:
        assert time.monotonic() < deadline, f"{topic.name} was never heard; {recorder.events[-5:]}"
        space.robot.publish(topic.name, kind.values(*values))
        await asyncio.sleep(0.05)
    await asyncio.sleep(0.2)  # what is still on its way


@pytest.mark.parametrize(
    ("kind", "values"),
    [(NUMBER, (1.5,)), (TEXT, ("Grüße",)), (TWIST, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))],
    ids=["number", "text", "structure"],
)
async def test_source_is_found_with_its_fields_and_its_type(space: Space, kind: Kind, values: tuple[Any, ...]) -> None:
    topic = source(space)
    async with started(space.make_driver()) as recorder:
        space.robot.advertise(topic.name, kind)
        await talk(space, recorder, topic, kind, *values)
        first = recorder.of(topic)[0]
        assert isinstance(first, SourceFound)
        assert first.name == topic.name or first.name == f"/{topic.name}"
        assert [(field.name, field.builtin_type) for field in first.fields] == list(kind.fields)
        assert field_property(first.fields[0], "RosType") == kind.ros_type
        assert recorder.samples(topic)[-1].values == values


async def test_source_that_was_there_before_the_driver_is_found(space: Space) -> None:
    topic = source(space)
    space.robot.advertise(topic.name, NUMBER)
    async with started(space.make_driver()) as recorder:
        await talk(space, recorder, topic, NUMBER, 1.0)
        assert len(recorder.found(topic)) == 1


async def test_samples_come_in_order_with_their_time(space: Space) -> None:
    topic = source(space)
    async with started(space.make_driver()) as recorder:
        space.robot.advertise(topic.name, NUMBER)
        await talk(space, recorder, topic, NUMBER, -1.0)
        heard = len(recorder.samples(topic))
        began_ns = time.time_ns()
        for number in range(50):
            space.robot.publish(topic.name, NUMBER.values(float(number)))
            await asyncio.sleep(0.002)
        await until(lambda: len(recorder.samples(topic)) >= heard + 50, "50 samples")
        samples = recorder.samples(topic)[heard:]
        assert [sample.values[0] for sample in samples] == [float(number) for number in range(50)]
        times = [sample.source_time_ns for sample in samples]
        assert times == sorted(times)
        assert began_ns - 10**9 <= times[0] <= times[-1] <= time.time_ns() + 10**9
        assert {(sample.status, sample.own_publication) for sample in samples} == {(0, False)}


async def test_another_spaces_messages_arrive_once_and_in_order(space: Space) -> None:
    metadata, driver = NUMBER.metadata(FOREIGN.name), space.make_driver()
    async with started(driver) as recorder:
        space.robot.subscribe(FOREIGN.name, NUMBER)
        number = 0.0
        while not space.robot.heard(FOREIGN.name):
            assert number < 400, "nothing arrived"
            assert driver.publish(FOREIGN, metadata, message_of(FOREIGN, number))
            number += 1
            await asyncio.sleep(0.05)
        for _ in range(20):
            assert driver.publish(FOREIGN, metadata, message_of(FOREIGN, number))
            number += 1
            await asyncio.sleep(0.002)
        await until(lambda: space.robot.heard(FOREIGN.name)[-1]["data"] == number - 1, "the last message")
        await asyncio.sleep(0.2)
        heard = [values["data"] for values in space.robot.heard(FOREIGN.name)]
        assert heard == [float(n) for n in range(int(heard[0]), int(number))]
        assert recorder.samples(FOREIGN) == []
        assert recorder.found(FOREIGN) == []


async def test_structure_of_another_space_arrives_with_all_its_values(space: Space) -> None:
    driver, values = space.make_driver(), (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    async with started(driver):
        space.robot.subscribe(FOREIGN.name, TWIST)
        for _ in range(400):
            assert driver.publish(FOREIGN, TWIST.metadata(FOREIGN.name), message_of(FOREIGN, *values, kind=TWIST))
            await asyncio.sleep(0.05)
            if space.robot.heard(FOREIGN.name):
                break
        assert space.robot.heard(FOREIGN.name)[0] == TWIST.values(*values)


async def test_own_publications_are_flagged_or_not_heard(space: Space) -> None:
    own, other, driver = source(space, 55), source(space, 56), space.make_driver()
    async with started(driver) as recorder:
        space.robot.subscribe(own.name, NUMBER)
        while not space.robot.heard(own.name):
            assert driver.publish(own, NUMBER.metadata(own.name), message_of(own, 1.0))
            await asyncio.sleep(0.05)
        space.robot.advertise(other.name, NUMBER)
        await talk(space, recorder, other, NUMBER, 2.0)
        assert all(sample.own_publication for sample in recorder.samples(own))


async def test_type_that_is_missing_is_refused_and_counted(space: Space) -> None:
    driver = space.make_driver()
    async with started(driver) as recorder:
        for _ in range(3):
            assert not driver.publish(FOREIGN, UNKNOWN.metadata(FOREIGN.name), message_of(FOREIGN, 1.0))
        await until(lambda: recorder.dropped(Drop.TYPE_MISSING) == 3, "three drops")


async def test_source_is_lost_once_and_comes_back(space: Space) -> None:
    topic = source(space)
    async with started(space.make_driver()) as recorder:
        space.robot.advertise(topic.name, NUMBER)
        await talk(space, recorder, topic, NUMBER, 1.0)
        assert recorder.lost(topic) == 0
        for times in (1, 2):
            space.robot.withdraw(topic.name)
            await until(lambda times=times: recorder.lost(topic) == times, "SourceLost")  # type: ignore[misc]  # no type for the default
            space.robot.advertise(topic.name, NUMBER)
            await until(lambda times=times: len(recorder.found(topic)) > times, "SourceFound")  # type: ignore[misc]  # as above
            await talk(space, recorder, topic, NUMBER, float(times + 1))
        kinds = [type(event).__name__ for event in recorder.of(topic) if not isinstance(event, SampleRead)]
        assert kinds == ["SourceFound", "SourceLost"] * 2 + ["SourceFound"]
        assert recorder.samples(topic)[-1].values == (3.0,)


async def test_illegal_names_are_counted_and_make_no_source(space: Space) -> None:
    legal = source(space)
    illegal = [f"ua_{space.number}_2_0", f"ua_0{space.number}_2_5", f"ua_{space.number}_2_70000"]
    async with started(space.make_driver()) as recorder:
        for name in illegal:
            space.robot.advertise(name, NUMBER)
        space.robot.advertise(legal.name, NUMBER)
        await talk(space, recorder, legal, NUMBER, 1.0)
        await until(lambda: recorder.dropped(Drop.ILLEGAL_TOPIC) >= len(illegal), "a drop for each name")
        assert {event.topic for event in recorder.events if isinstance(event, SourceFound)} == {legal}


async def test_robots_side_may_come_later(absent_space: Space) -> None:
    if not absent_space.can_be_absent:
        pytest.skip("this space has nothing that must be up")
    space, topic = absent_space, source(absent_space)
    driver = space.make_driver()
    async with started(driver) as recorder:
        await asyncio.sleep(0.3)
        status = driver.status()
        assert not status.connected
        assert status.detail
        assert "\n" not in status.detail
        space.appear()
        await until(lambda: driver.status().connected, "the connection")
        space.robot.advertise(topic.name, NUMBER)
        await talk(space, recorder, topic, NUMBER, 1.0)


async def test_mistake_of_the_driver_is_no_silent_end(space: Space) -> None:
    """It works again by itself, or is over, which ends its bridge. Meanwhile no value of it is shown as Good."""
    topic, driver = source(space), space.make_driver()
    async with started(driver) as recorder:
        space.robot.advertise(topic.name, NUMBER)
        await talk(space, recorder, topic, NUMBER, 1.0)
        with broken(space.own_work):
            space.robot.publish(topic.name, NUMBER.values(2.0))
            await until(lambda: driver.status().is_over or recorder.lost(topic), "the end, or the loss")
            status = driver.status()
            assert not status.connected
            assert "a mistake of the bridge" in status.detail
        if not driver.status().is_over:
            await talk(space, recorder, topic, NUMBER, 3.0)
            assert len(recorder.found(topic)) == 2


async def test_stop_releases_everything_and_may_be_called_twice(space: Space) -> None:
    topic, driver = source(space), space.make_driver()
    before = set(threading.enumerate())
    recorder = Recorder()
    await driver.start(recorder)
    space.robot.advertise(topic.name, NUMBER)
    await talk(space, recorder, topic, NUMBER, 1.0)
    assert driver.publish(FOREIGN, NUMBER.metadata(FOREIGN.name), message_of(FOREIGN, 1.0))
    await until(lambda: driver.status().connected, "the connection")
    await driver.stop()
    heard = len(recorder.events)
    await driver.stop()
    assert not driver.status().connected

    def left() -> set[threading.Thread]:
        pool = {thread for thread in threading.enumerate() if thread.name.startswith("asyncio_")}
        return set(threading.enumerate()) - before - pool

    await until(lambda: not left(), f"the end of {left()}", 10)
    space.robot.publish(topic.name, NUMBER.values(2.0))
    await asyncio.sleep(0.2)
    assert len(recorder.events) == heard


async def test_a_new_driver_works_where_another_has_stopped(space: Space) -> None:
    topic = source(space)
    space.robot.advertise(topic.name, NUMBER)
    for _ in range(2):
        async with started(space.make_driver()) as recorder:
            await talk(space, recorder, topic, NUMBER, 1.0)
            assert recorder.samples(topic)[-1].values == (1.0,)
            assert recorder.lost(topic) == 0


async def test_source_that_misbehaves_is_put_aside_alone_and_tried_again(space: Space) -> None:
    bad, good, driver = source(space, 1001), source(space, 1002), space.make_driver()
    if not hasattr(space.robot, "misbehave"):
        pytest.skip("its robots have no wire that could carry rubbish")
    async with started(driver) as recorder:
        for topic in (bad, good):
            space.robot.advertise(topic.name, NUMBER)
            await talk(space, recorder, topic, NUMBER, 1.0)
        assert driver.status().aside == {}
        for number in range(200):
            space.robot.misbehave(bad.name)
            space.robot.publish(good.name, NUMBER.values(float(number)))
            await asyncio.sleep(0.05)
            if driver.status().aside:
                break
        ((name, reason),) = driver.status().aside.items()
        assert bad.name in name
        assert reason
        assert "\n" not in reason
        assert recorder.dropped(Drop.MISBEHAVED) == 1
        await until(lambda: recorder.lost(bad) == 1, "SourceLost")
        await talk(space, recorder, good, NUMBER, 2.0)
        assert recorder.lost(good) == 0
        await talk(space, recorder, bad, NUMBER, 3.0)
        assert recorder.samples(bad)[-1].values == (3.0,)
