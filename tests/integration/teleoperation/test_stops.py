"""A robot of rclpy or rospy records each speed with its time: when it stops, and by whom."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from itertools import pairwise
from typing import Any, Final

import pytest

from tests.integration.teleoperation.conftest import (
    BOTH,
    DEADMAN_S,
    PERIOD_S,
    ROBOT_TIMEOUT_S,
    SPEED,
    STOP_S,
    Hall,
    Speed,
)
from tests.integration.teleoperation.driving import WAIT_S, Driver, driving
from ua_fleet.skill.executions import OutcomeKind
from ua_fleet.storage.key_files import KeyFolder
from ua_fleet.teleoperation import State
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode

SECURED: Final[dict[str, Any]] = {"security": "sign_and_encrypt", "keys": {"source": "files"}}
SLACK_S: Final = 0.15
"""For processes that share two cores with other tests."""


def found_stop(speeds: list[Speed], after: float) -> tuple[float, float]:
    """When the stop began and when it was over: the last speed before it fell, and the first zero; 0.0 where not."""
    began = 0.0
    for before, speed in pairwise(speeds):
        if speed.at < after:
            continue
        if not began and speed.linear < before.linear:
            began = before.at
        if began and not speed.linear:
            return began, speed.at
    return began, 0.0


async def stop_of(hall: Hall, after: float) -> tuple[float, float]:
    """As the robot heard it, which may be later than the bridge's word that it is idle."""
    return found_stop(await hall.until(lambda speeds: all(found_stop(speeds, after)), "heard"), after)


async def full_speed(hall: Hall, driver: Driver) -> None:
    """Get the robot and have it drive; again where a busy machine has sent no setpoint for DEADMAN_S."""
    async with asyncio.timeout(WAIT_S):
        while True:
            await driver.acquired()
            await driver.drive(0.1, 0.0)
            await driver.drive(1.2, SPEED)
            if hall.speeds()[-1].linear == pytest.approx(SPEED):
                return
            await rest(driver)


async def stands(hall: Hall, since: float) -> None:
    """Wait until it stands, and see that it never moves again."""
    await hall.until(lambda speeds: speeds[-1].at > since and not speeds[-1].linear)
    stood = hall.speeds()[-1].at
    await asyncio.sleep(0.5)
    assert [speed for speed in hall.speeds("moved", stood) if speed.linear or speed.angular] == []


@BOTH
async def test_driven_released_and_stopped_when_setpoints_cease(hall: Hall) -> None:
    config = hall.fleet(**SECURED)
    hall.start_robot()
    hall.start_bridge()
    async with driving(config, hall.folder, "anna") as (anna,):
        await full_speed(hall, anna)
        released = time.monotonic()
        assert (await anna.ask(anna.model.release, anna.lease, "released")).kind is OutcomeKind.ACCEPTED
        await rest(anna)
        began, ended = await stop_of(hall, released)
        assert began - released < PERIOD_S + SLACK_S
        assert ended - began < STOP_S + 3 * PERIOD_S + SLACK_S
        await stands(hall, released)
        assert anna.status is not None
        assert anna.status.last_end == "anna: released"

        await full_speed(hall, anna)
        last = await anna.drive(0.1, SPEED)
        await rest(anna)
        began, ended = await stop_of(hall, last)
        assert began - last < DEADMAN_S + PERIOD_S + SLACK_S
        assert ended - began < STOP_S + 3 * PERIOD_S + SLACK_S
        await stands(hall, last)
        assert anna.status.last_end == "anna: no setpoint was fresh for 300 ms"
        for before, after in pairwise(hall.speeds("heard")):
            # Three periods more: one may be heard late, and the next one not.
            assert abs(after.linear - before.linear) < 2.0 * (after.at - before.at + 3 * PERIOD_S), "a jump"


async def rest(driver: Driver) -> None:
    await driver.until(lambda status: status.state is State.IDLE)


async def test_an_old_echo_is_an_old_wish_however_often_it_is_sent(hall: Hall) -> None:
    config = hall.fleet()
    hall.start_robot()
    hall.start_bridge()
    async with driving(config, hall.folder, "anna") as (anna,):
        await full_speed(hall, anna)
        status = anna.status
        assert status is not None
        anna.echo, seen = status.counter, time.monotonic()
        await anna.drive(1.0, SPEED)
        await rest(anna)
        began, _ = await stop_of(hall, seen)
        assert began - seen < DEADMAN_S + PERIOD_S + SLACK_S
        await stands(hall, seen)
        status = await anna.until(lambda status: status.state is State.IDLE)
        lease, number, echo, setpoint = status.drops
        assert lease > 0
        assert (number, setpoint) == (0, 0)
        assert echo <= 1


async def test_repeated_and_foreign_setpoints_are_counted_and_move_nothing(hall: Hall) -> None:
    config = hall.fleet()
    hall.start_robot()
    hall.start_bridge()
    async with driving(config, hall.folder, "anna", "ben", "eve") as (anna, ben, eve):
        await full_speed(hall, anna)
        refused = await ben.acquire()
        assert (refused.kind, refused.report.status) == (OutcomeKind.REFUSED, StatusCode.BAD_RESOURCE_UNAVAILABLE)
        assert "carrier is driven by anna" in refused.report.message
        before = hall.speeds()[-1].at
        for number in range(10):
            ben.send(-SPEED, number=number + 1, lease=anna.lease + 1)  # a guessed lease
            ben.send(-SPEED, number=1, lease=anna.lease)  # a stolen one, with an old number
            await anna.drive(0.02, SPEED)
        assert {speed.linear for speed in hall.speeds("moved", before)} == {SPEED}
        status = await anna.until(lambda status: status.drops[0] == 10 and status.drops[1] == 10)
        assert (status.holder, status.drops[2:]) == ("anna", (0, 0))

        asked = time.monotonic()
        taken = await eve.acquire(take_over=True)
        assert taken.kind is OutcomeKind.ACCEPTED
        assert eve.lease > anna.lease
        at = time.monotonic()
        sending = asyncio.ensure_future(anna.drive(1.0, -SPEED))
        await eve.drive(1.0, 0.2)
        await sending
        status = await eve.until(lambda status: status.state is State.HELD)
        assert (status.holder, status.last_end) == ("eve", "anna: taken over by eve")
        # All that came: of what waits for a robot that has to wait for a core, its own watch takes the last.
        assert min(speed.linear for speed in hall.speeds("heard", asked)) == 0.0
        assert hall.speeds("moved", at)[-1].linear == pytest.approx(0.2)
        _, ended = await stop_of(hall, at)
        assert ended - at < STOP_S + 4 * PERIOD_S + SLACK_S


@BOTH
async def test_a_frozen_bridge_leaves_the_robot_to_its_own_watch(hall: Hall) -> None:
    config = hall.fleet()
    hall.start_robot()
    bridge = hall.start_bridge()
    async with driving(config, hall.folder, "anna") as (anna,):
        await full_speed(hall, anna)
        driving_on = asyncio.ensure_future(anna.drive(2.5, SPEED))
        os.killpg(bridge.process.pid, signal.SIGSTOP)
        frozen = time.monotonic()
        await hall.until(lambda speeds: not speeds[-1].linear)
        stopped = hall.speeds()[-1].at
        assert stopped - frozen < ROBOT_TIMEOUT_S + SLACK_S
        await asyncio.sleep(0.6)
        os.killpg(bridge.process.pid, signal.SIGCONT)
        await driving_on
        status = await anna.until(lambda status: status.lease == 0)
        assert "the bridge stood still, and the robot has stopped by itself" in status.last_end
        assert {speed.linear for speed in hall.speeds("heard", stopped)} == {0.0}
        assert {speed.linear for speed in hall.speeds("moved", stopped)} == {0.0}
        await full_speed(hall, anna)


async def test_a_killed_bridge_leaves_the_robot_to_its_own_watch_and_the_next_gives_greater_numbers(hall: Hall) -> None:
    config = hall.fleet()
    hall.start_robot()
    bridge = hall.start_bridge()
    async with driving(config, hall.folder, "anna") as (anna,):
        await full_speed(hall, anna)
        lease = anna.lease
        bridge.end(signal.SIGKILL)
        killed = time.monotonic()
        await hall.until(lambda speeds: not speeds[-1].linear)
        assert hall.speeds()[-1].at - killed < ROBOT_TIMEOUT_S + SLACK_S
        await anna.drive(0.3, SPEED)
        hall.start_bridge()
        again = time.monotonic()
        await anna.drive(0.5, SPEED)  # the lease of the bridge before
        assert [speed for speed in hall.speeds("heard", again) if speed.linear] == []
        await full_speed(hall, anna)
        assert anna.lease > lease + 1


async def test_a_bridge_that_ends_in_order_brings_the_robot_to_a_standstill(hall: Hall) -> None:
    config = hall.fleet()
    hall.start_robot()
    bridge = hall.start_bridge()
    async with driving(config, hall.folder, "anna") as (anna,):
        await full_speed(hall, anna)
        ending = time.monotonic()
        driving_on = asyncio.ensure_future(anna.drive(1.0, SPEED))
        assert await asyncio.to_thread(bridge.end) == 0
        await driving_on
        began, ended = await stop_of(hall, ending)
        assert ended - began < STOP_S + 3 * PERIOD_S + SLACK_S
        await stands(hall, ending)


async def test_without_its_keys_no_setpoint_is_fresh(hall: Hall) -> None:
    config = hall.fleet(**SECURED)
    hall.start_robot()
    hall.start_bridge()
    async with driving(config, hall.folder, "anna") as (anna,):
        await full_speed(hall, anna)
        keys, group_id = KeyFolder(hall.folder / "keys"), f"c-{hall.space}"
        own = anna.requestor.envelope
        own.install = lambda *_: None  # type: ignore[method-assign]  # the server's place keeps the key that is gone
        driving_on = asyncio.ensure_future(anna.drive(3.0, SPEED))
        keys.write(keys.read(group_id).replaced(time.time()))
        status = await anna.until(lambda status: status.lease == 0)
        assert status.last_end == "anna: no setpoint was fresh for 300 ms"
        await driving_on
        await stands(hall, 0.0)


async def test_a_robot_has_one_occupation(hall: Hall) -> None:
    config = hall.fleet()
    hall.start_robot()
    hall.start_bridge()
    skill = Topic(hall.space, 2, 1010)
    async with driving(config, hall.folder, "anna") as (anna,):
        await anna.acquired()
        refused = await anna.requestor.invoke(skill, (0.1,), WAIT_S)
        assert (refused.kind, refused.report.status) == (OutcomeKind.REFUSED, StatusCode.BAD_TOO_MANY_OPERATIONS)
        assert refused.report.message == "carrier does no skill now: it is driven by hand, by anna"
        await anna.ask(anna.model.release, anna.lease, "released")
        await rest(anna)
        async with asyncio.timeout(WAIT_S):
            while (await anna.requestor.invoke(skill, (1.0,), WAIT_S)).kind is not OutcomeKind.ACCEPTED:
                await asyncio.sleep(0.05)
        busy = await anna.acquire()
        assert (busy.kind, busy.report.status) == (OutcomeKind.REFUSED, StatusCode.BAD_INVALID_STATE)
        assert busy.report.message == ("carrier cannot be driven: it does `wave`; halt that first, or wait for its end")
        await anna.acquired()


async def test_a_robot_that_does_not_listen_is_not_given_out(hall: Hall) -> None:
    config = hall.fleet()
    hall.start_bridge()
    async with driving(config, hall.folder, "anna") as (anna,):
        refused = await anna.acquire()
        assert refused.kind is OutcomeKind.REFUSED
        assert "/cmd_vel has no subscriber in ROS" in refused.report.message
        robot = hall.start_robot()
        await anna.acquired()
        robot.end(signal.SIGTERM)
        status = await anna.until(lambda status: status.lease == 0)
        assert status.last_end == "anna: /cmd_vel has no subscriber in ROS"
