"""What changes around a robot while it is driven: keys that rotate, and a second process of its bridge."""

from __future__ import annotations

import asyncio
import shutil
import time
from typing import Any, Final

import pytest

from tests.integration.teleoperation.conftest import SPEED, Hall
from tests.integration.teleoperation.driving import WAIT_S, Driver, driving
from tests.integration.teleoperation.test_stops import SECURED, full_speed, stands
from ua_fleet.skill.executions import OutcomeKind
from ua_fleet.storage.key_files import KeyFolder
from ua_fleet.wire.security import read_security

LONG_S: Final = 3.0
"""A deadman's time that is none of a busy machine's: what stops the robot here is no late setpoint."""


def number_taken(driver: Driver) -> int:
    """Of the last setpoint that the bridge says it has taken."""
    assert driver.status is not None
    return driver.status.number


async def driven_until(driver: Driver, is_so: Any) -> None:
    """Drive on until something is so; the robot must not have been stopped meanwhile."""
    async with asyncio.timeout(WAIT_S):
        while not is_so():
            await driver.drive(0.1, SPEED)
            status = driver.status
            assert status is not None
            assert status.lease == driver.lease, status.last_end


async def test_keys_that_rotate_stop_no_robot(hall: Hall) -> None:
    config = hall.fleet(deadman_s=LONG_S, **SECURED)
    hall.start_robot()
    hall.start_bridge()
    async with driving(config, hall.folder, "anna") as (anna,):
        transport, tokens = anna.requestor.transport, list[int]()
        send = transport.send

        def noted(datagram: bytes, address: Any = None) -> None:
            heard = read_security(datagram)
            if heard.writer_group_id == anna.model.setpoints.writer_group_id:
                tokens.append(heard.token_id)
            send(datagram, address)

        transport.send = noted  # type: ignore[method-assign]
        await full_speed(hall, anna)
        keys = KeyFolder(hall.folder / "keys")
        for rotation in (1, 2):
            for group_id in keys.groups():
                keys.write(keys.read(group_id).rotated(time.time(), 1.0, 1))
            await driven_until(anna, lambda wanted=rotation + 1: tokens[-1] == wanted)
            last = anna.number
            await driven_until(anna, lambda number=last: number_taken(anna) > number)
        assert [speed.linear for speed in hall.speeds()[-20:]] == pytest.approx([SPEED] * 20)
        assert sorted(set(tokens)) == [1, 2, 3]


async def test_a_second_process_of_the_bridge_drives_nothing(hall: Hall) -> None:
    config = hall.fleet(deadman_s=LONG_S, **SECURED)
    hall.start_robot()
    first = hall.start_bridge()
    async with driving(config, hall.folder, "anna", "berta") as (anna, berta):
        await full_speed(hall, anna)
        at_speed = time.monotonic()
        # Its own state: it gives the same numbers of leases, and its journal knows of nothing.
        other = hall.folder / "other"
        other.mkdir()
        shutil.copy(hall.folder / "fleet.json", other)
        shutil.copytree(hall.folder / "keys", other / "keys")
        starting = asyncio.ensure_future(asyncio.to_thread(hall.start_bridge_in, other))
        await driven_until(anna, starting.done)
        second = await starting
        await driven_until(anna, lambda: any("says that it is this bridge" in line for line in second.lines))
        outcome = await berta.acquire(take_over=True)
        assert outcome.kind is not OutcomeKind.ACCEPTED
        assert "another process" in outcome.report.message
        await anna.drive(0.5, SPEED)
        status = anna.status
        assert status is not None
        assert status.lease == anna.lease
        heard = [speed.linear for speed in hall.speeds("heard", at_speed)]
        assert heard == pytest.approx([SPEED] * len(heard)), "one of them writes something else"
        # The one that drives is gone: the other one follows no setpoint of its lease.
        killed = time.monotonic()
        first.end(9)
        await anna.drive(1.0, SPEED)
        await stands(hall, killed)
