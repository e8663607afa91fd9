"""The contract of `ua_fleet.bridge.driver.Driver` for robots without topics: `fleet.yaml` names what they have."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

import pytest

from tests.contract.harness import NUMBER, TEXT, TWIST, Kind, MappedSpace, Recorder, broken, message_of
from tests.contract.test_driver import started
from tests.waiting import until
from ua_fleet.bridge import SampleRead, SourceFound
from ua_fleet.counters import Drop
from ua_fleet.errors import FieldMissing
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

VALUES: dict[str, tuple[Any, ...]] = {
    NUMBER.ros_type: (1.5,),
    TEXT.ros_type: ("Grüße",),
    TWIST.ros_type: (1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
}


def of_kind(topics: dict[Topic, Kind], kind: Kind) -> Topic:
    found = next((topic for topic, there in topics.items() if there is kind), None)
    if found is None:
        pytest.skip(f"such a robot has no {kind.ros_type}")
    return found


async def show(space: MappedSpace, recorder: Recorder, topic: Topic, *values: Any) -> None:
    """Have the robot show values, and wait until the driver has told them."""
    await asyncio.to_thread(space.robot.show, topic, values)
    await until(
        lambda: recorder.samples(topic) and recorder.samples(topic)[-1].values == values, f"{values} of {topic.name}"
    )


@pytest.mark.parametrize("kind", [NUMBER, TEXT, TWIST], ids=["number", "text", "structure"])
async def test_source_is_found_with_its_fields_and_its_values(mapped_space: MappedSpace, kind: Kind) -> None:
    topic, values = of_kind(dict(mapped_space.sources), kind), VALUES[kind.ros_type]
    async with started(mapped_space.make_driver()) as recorder:
        await show(mapped_space, recorder, topic, *values)
        first = recorder.of(topic)[0]
        assert isinstance(first, SourceFound)
        assert [field.builtin_type for field in first.fields] == [builtin for _, builtin in kind.fields]
        if len(kind.fields) > 1:
            assert [field.name for field in first.fields] == [name for name, _ in kind.fields]
        assert len(recorder.found(topic)) == 1


async def test_samples_come_in_order_with_their_time(mapped_space: MappedSpace) -> None:
    topic = next(iter(mapped_space.sources))
    async with started(mapped_space.make_driver()) as recorder:
        await show(mapped_space, recorder, topic, -1.0)
        heard, began_ns = len(recorder.samples(topic)), time.time_ns()
        for number in range(50):
            if mapped_space.is_sampled:  # a busy machine may let the driver wait for any length of time
                await show(mapped_space, recorder, topic, float(number))
            else:
                await asyncio.to_thread(mapped_space.robot.show, topic, (float(number),))
        await until(lambda: len(recorder.samples(topic)) >= heard + 50, "50 samples")
        samples = recorder.samples(topic)[heard:]
        assert [sample.values[0] for sample in samples] == [float(number) for number in range(50)]
        times = [sample.source_time_ns for sample in samples]
        assert times == sorted(times)
        assert began_ns - 10**9 <= times[0] <= times[-1] <= time.time_ns() + 10**9
        assert {(sample.status, sample.own_publication) for sample in samples} == {(0, False)}


async def test_another_spaces_messages_arrive_once_and_in_order(mapped_space: MappedSpace) -> None:
    topic, driver = of_kind(dict(mapped_space.sinks), NUMBER), mapped_space.make_driver()
    metadata = NUMBER.metadata(topic.name)
    async with started(driver) as recorder:
        await until(lambda: driver.status().connected, "the connection")
        for number in range(30):
            assert driver.publish(topic, metadata, message_of(topic, float(number)))
            await asyncio.sleep(0.002)
        await until(lambda: mapped_space.robot.taken(topic)[-1:] == [(29.0,)], "the last message")
        assert mapped_space.robot.taken(topic) == [(float(number),) for number in range(30)]
        assert recorder.of(topic) == []


async def test_structure_of_another_space_arrives_with_all_its_values(mapped_space: MappedSpace) -> None:
    topic, driver = of_kind(dict(mapped_space.sinks), TWIST), mapped_space.make_driver()
    values = VALUES[TWIST.ros_type]
    async with started(driver):
        await until(lambda: driver.status().connected, "the connection")
        assert driver.publish(topic, TWIST.metadata(topic.name), message_of(topic, *values, kind=TWIST))
        await until(lambda: values in mapped_space.robot.taken(topic), "the values")


async def test_fields_go_by_their_names_whatever_order_their_sender_has(mapped_space: MappedSpace) -> None:
    topic, driver = of_kind(dict(mapped_space.sinks), TWIST), mapped_space.make_driver()
    values = VALUES[TWIST.ros_type]
    turned = Kind(TWIST.ros_type, (("more", BuiltinType.DOUBLE), *reversed(TWIST.fields)))
    async with started(driver):
        await until(lambda: driver.status().connected, "the connection")
        message = message_of(topic, 0.0, *reversed(values), kind=turned)
        assert driver.publish(topic, turned.metadata(topic.name), message)
        await until(lambda: values in mapped_space.robot.taken(topic), "the values")


async def test_a_message_without_a_field_is_refused_with_its_name(mapped_space: MappedSpace) -> None:
    topic, driver = of_kind(dict(mapped_space.sinks), TWIST), mapped_space.make_driver()
    less = Kind(TWIST.ros_type, TWIST.fields[:-1])
    async with started(driver):
        await until(lambda: driver.status().connected, "the connection")
        with pytest.raises(FieldMissing, match=r"no field 'angular\.z', but linear\.x"):
            driver.publish(topic, less.metadata(topic.name), message_of(topic, *range(5), kind=less))
        assert mapped_space.robot.taken(topic) == []


async def test_data_without_a_place_is_counted_and_goes_nowhere(mapped_space: MappedSpace) -> None:
    driver, nowhere = mapped_space.make_driver(), Topic(78, 2, 4711)
    async with started(driver) as recorder:
        await until(lambda: driver.status().connected, "the connection")
        assert not driver.publish(nowhere, NUMBER.metadata(nowhere.name), message_of(nowhere, 1.0))
        await until(lambda: recorder.dropped(Drop.UNMAPPED) == 1, "the drop")


async def test_what_does_not_fit_is_refused_and_counted(mapped_space: MappedSpace) -> None:
    topic, driver = of_kind(dict(mapped_space.sinks), NUMBER), mapped_space.make_driver()
    async with started(driver) as recorder:
        await until(lambda: driver.status().connected, "the connection")
        message = message_of(topic, "no number", kind=TEXT)
        assert not driver.publish(topic, TEXT.metadata(topic.name), message)
        await until(lambda: recorder.dropped(Drop.CONVERSION) == 1, "the drop")
        assert mapped_space.robot.taken(topic) == []


async def test_robot_that_leaves_is_lost_once_and_comes_back(mapped_space: MappedSpace) -> None:
    space, topic = mapped_space, next(iter(mapped_space.sources))
    driver = space.make_driver()
    async with started(driver) as recorder:
        await show(space, recorder, topic, 1.0)
        for times in (1, 2):
            space.robot.leave()
            await until(lambda: recorder.lost(topic) == times, "SourceLost")  # noqa: B023 - awaited in its turn
            await until(lambda: not driver.status().connected, "the status")
            assert "\n" not in driver.status().detail
            space.robot.come_back()
            await until(lambda: len(recorder.found(topic)) > times, "SourceFound")  # noqa: B023 - as above
            await show(space, recorder, topic, float(times + 1))
        kinds = [type(event).__name__ for event in recorder.of(topic) if not isinstance(event, SampleRead)]
        assert kinds == ["SourceFound", "SourceLost"] * 2 + ["SourceFound"]


async def test_what_is_written_to_an_absent_robot_is_counted(mapped_space: MappedSpace) -> None:
    space, driver = mapped_space, mapped_space.make_driver()
    topic = of_kind(dict(space.sinks), NUMBER)
    async with started(driver) as recorder:
        await until(lambda: driver.status().connected, "the connection")
        space.robot.leave()
        await until(lambda: not driver.status().connected, "the loss")
        assert not driver.publish(topic, NUMBER.metadata(topic.name), message_of(topic, 1.0))
        await until(lambda: recorder.dropped(Drop.NOT_CONNECTED) == 1, "the drop")


async def test_robot_may_come_later(absent_mapped_space: MappedSpace) -> None:
    space, topic = absent_mapped_space, next(iter(absent_mapped_space.sources))
    driver = space.make_driver()
    async with started(driver) as recorder:
        await asyncio.sleep(0.3)
        status = driver.status()
        assert not status.connected
        assert status.detail
        assert "\n" not in status.detail
        assert recorder.found(topic) == []
        space.appear()
        await until(lambda: driver.status().connected, "the connection")
        await show(space, recorder, topic, 1.0)


async def test_mistake_of_the_driver_is_no_silent_end(mapped_space: MappedSpace) -> None:
    """It works again by itself, or is over, which ends its bridge. Meanwhile no value of it is shown as Good."""
    space, topic = mapped_space, next(iter(mapped_space.sources))
    driver = space.make_driver()
    async with started(driver) as recorder:
        await show(space, recorder, topic, 1.0)
        with broken(space.own_work):
            await asyncio.to_thread(space.robot.show, topic, (2.0,))
            await until(lambda: driver.status().is_over or recorder.lost(topic), "the end, or the loss")
            status = driver.status()
            assert not status.connected
            assert "a mistake of the bridge" in status.detail
        if not driver.status().is_over:
            await show(space, recorder, topic, 3.0)
            assert len(recorder.found(topic)) == 2


async def test_robot_that_misbehaves_is_put_aside_and_tried_again(mapped_space: MappedSpace) -> None:
    space, topic = mapped_space, next(iter(mapped_space.sources))
    driver = space.make_driver()
    async with started(driver) as recorder:
        await show(space, recorder, topic, 1.0)
        assert driver.status().aside == {}
        await asyncio.to_thread(space.robot.misbehave)
        await until(lambda: driver.status().aside, "that it is put aside")
        ((_, reason),) = driver.status().aside.items()
        assert reason
        assert "\n" not in reason
        assert recorder.dropped(Drop.MISBEHAVED) >= 1
        await until(lambda: recorder.lost(topic) == 1 and not driver.status().connected, "the loss")
        await asyncio.to_thread(space.robot.behave)
        await until(lambda: len(recorder.found(topic)) == 2, "that it is tried again", 40)
        await show(space, recorder, topic, 2.0)


async def test_stop_releases_everything_and_may_be_called_twice(mapped_space: MappedSpace) -> None:
    space, topic = mapped_space, next(iter(mapped_space.sources))
    driver, recorder, before = space.make_driver(), Recorder(), set(threading.enumerate())
    await driver.start(recorder)
    await show(space, recorder, topic, 1.0)
    await driver.stop()
    heard = len(recorder.events)
    await driver.stop()
    assert not driver.status().connected

    def left() -> set[threading.Thread]:
        pool = {thread for thread in threading.enumerate() if thread.name.startswith("asyncio_")}
        return set(threading.enumerate()) - before - pool

    await until(lambda: not left(), f"the end of {left()}", 10)
    await asyncio.sleep(0.2)
    assert len(recorder.events) == heard


async def test_a_new_driver_works_where_another_has_stopped(mapped_space: MappedSpace) -> None:
    topic = next(iter(mapped_space.sources))
    for number in (1.0, 2.0):
        async with started(mapped_space.make_driver()) as recorder:
            await show(mapped_space, recorder, topic, number)
            assert [sample.values for sample in recorder.samples(topic)][-1] == (number,)
            assert recorder.lost(topic) == 0
