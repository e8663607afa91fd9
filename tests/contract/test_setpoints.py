"""The contract of a `ua_fleet.bridge.Driver` whose robots are driven by hand: a setpoint is written now, or never."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from tests.contract.harness import DrivenSpace, Recorder
from tests.waiting import until
from ua_fleet.bridge import Driver
from ua_fleet.counters import Drop


@asynccontextmanager
async def started(driver: Driver) -> AsyncGenerator[tuple[Driver, Recorder]]:
    recorder = Recorder()
    await driver.start(recorder)
    try:
        yield driver, recorder
    finally:
        await driver.stop()


async def test_setpoints_arrive_in_order_once_the_robot_listens(driven_space: DrivenSpace) -> None:
    space = driven_space
    async with started(space.make_driver()) as (driver, recorder):
        space.listen()
        await until(lambda: not driver.setpoint_problem(space.topic), "the robot to listen")
        async with asyncio.timeout(60):
            while not space.heard():  # the robot may know of the link a little later than the driver
                driver.write_setpoint(space.topic, (0.0, 0.0))
                await asyncio.sleep(0.05)
        written = [(number / 10, -number / 100) for number in range(1, 30)]
        for values in written:  # a driver may let go of one for which the next one has come
            driver.write_setpoint(space.topic, values)
            await until(lambda values=values: space.heard()[-1:] == [values], "the setpoint")  # type: ignore[misc]
        assert [values for values in space.heard() if any(values)] == written
        burst = [(number / 10, -number / 100) for number in range(30, 60)]
        for values in burst:
            driver.write_setpoint(space.topic, values)
            await asyncio.sleep(0.01)
        await until(lambda: space.heard()[-1:] == burst[-1:], "the last setpoint")
        heard = [values for values in space.heard() if any(values)]
        assert heard == sorted(set(heard))
        assert recorder.dropped(Drop.CONVERSION) == 0


async def test_what_nobody_hears_is_told_and_never_comes_later(driven_space: DrivenSpace) -> None:
    space = driven_space
    async with started(space.make_driver()) as (driver, _):
        for _ in range(100):
            assert driver.setpoint_problem(space.topic)
            driver.write_setpoint(space.topic, (0.5, 0.0))
            await asyncio.sleep(0.02)
        space.listen()
        await until(lambda: not driver.setpoint_problem(space.topic), "the robot to listen")
        await asyncio.sleep(0.5)
        assert space.heard() == []
        driver.write_setpoint(space.topic, (0.25, 0.0))
        await until(lambda: space.heard() == [(0.25, 0.0)], "a setpoint")


async def test_a_driver_that_has_left_writes_nothing_and_says_so(driven_space: DrivenSpace) -> None:
    space = driven_space
    async with started(space.make_driver()) as (driver, _):
        space.listen()
        await until(lambda: not driver.setpoint_problem(space.topic), "the robot to listen")
    assert driver.setpoint_problem(space.topic)
    driver.write_setpoint(space.topic, (0.5, 0.0))
    assert space.heard() == []
