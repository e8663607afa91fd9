"""The typed client drives a robot: a lease as a context, its end, and why."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import AbstractAsyncContextManager, aclosing
from pathlib import Path

import pytest

from tests.integration.server_model.harness import ENGINEER, OBSERVER, OPERATOR
from tests.integration.teleoperation.served import DEADMAN_MS, Floor, fleet, floor, until_value
from ua_fleet.client import (
    AxisInfo,
    ClientIdentity,
    DrivingLease,
    FleetClient,
    NodeNotFound,
    driving,
    teleoperation_info,
    watch_teleoperation,
)
from ua_fleet.errors import AccessRefused, LeaseRefused
from ua_fleet.teleoperation.messages import SETPOINT_DROPS as DROPS
from ua_fleet.values import StatusCode


@pytest.fixture
async def made(tmp_path: Path, udp_url: str, tcp_port: int) -> AsyncGenerator[Floor]:
    async with floor(tmp_path, fleet(udp_url, tcp_port)) as found:
        yield found


def connect(made: Floor, user: tuple[str, str]) -> AbstractAsyncContextManager[FleetClient]:
    identity = ClientIdentity(made.running.folder / "identity")
    return FleetClient.connect(made.running.url, user=user[0], password=user[1], identity=identity)


async def drive_until(lease: DrivingLease, is_so: Callable[[], bool], **values: float) -> None:
    async with asyncio.timeout(30):
        while not is_so():
            await lease.drive(values)
            await asyncio.sleep(0.02)


async def test_a_robot_is_held_while_the_context_lasts(made: Floor) -> None:
    async with connect(made, OPERATOR) as client, made.running.client(OBSERVER) as onlooker:
        info = await teleoperation_info(client, "carrier")
        assert info.axes[0] == AxisInfo("linear", "", 0.5, 1.0, 2.0, 20.0)
        assert (info.deadman_s, info.lease_s, info.robot_timeout_s) == (DEADMAN_MS / 1000, 5.0, 10.0)
        async with driving(client, info) as lease:
            wish = pytest.approx((0.4, 0.3))
            await drive_until(lease, lambda: made.carrier.written[-1:] == [wish], angular=0.3, linear=0.4)
            assert lease.status.is_good
            assert lease.status.holder == "oscar"
            assert lease.status.last_number > 0
            assert lease.age_s < DEADMAN_MS / 1000
            assert 0 < lease.round_trip_s < 1
            with pytest.raises(LeaseRefused, match="carrier has no axis 'sideways'; there are: linear, angular"):
                await lease.drive({"sideways": 0.1})
            assert lease.over == ""
        assert await until_value(onlooker, "LastEnd", bool) == "oscar: released"


async def test_a_lease_without_setpoints_is_renewed(made: Floor) -> None:
    async with connect(made, OPERATOR) as client, driving(client, "carrier") as lease:
        await asyncio.sleep(6.5)
        assert not lease.over
        assert lease.status.lease == lease.number


async def test_who_cannot_follow_the_bridge_gives_the_robot_back(tmp_path: Path, udp_url: str, tcp_port: int) -> None:
    config = fleet(udp_url, tcp_port)
    few = config.server.model_copy(update={"max_subscriptions_per_session": 1})
    async with (
        floor(tmp_path, config.model_copy(update={"server": few})) as made,
        connect(made, OPERATOR) as client,
        aclosing(client.watch(["ns=2;s=1003.State"])) as changes,
    ):
        await anext(changes)
        async with driving(client, "carrier") as lease, asyncio.timeout(60):
            while not lease.over:
                await lease.changed.wait()
                lease.changed.clear()
            assert "BadTooManySubscriptions" in lease.over
            async for change in changes:
                if change.value == 0:
                    break
        (told,) = await client.read(["ns=2;s=1003.LastEnd"])
        assert told.value == "oscar: released"


async def test_who_is_overruled_learns_by_whom(made: Floor) -> None:
    async with connect(made, OPERATOR) as one, connect(made, ENGINEER) as two, driving(one, "carrier") as lease:
        with pytest.raises(LeaseRefused, match="carrier is driven by oscar") as refused:
            async with driving(two, "carrier"):
                raise AssertionError
        assert refused.value.ua_status == StatusCode.BAD_RESOURCE_UNAVAILABLE
        async with driving(two, "carrier", take_over=True) as other:
            assert other.taken_from == "oscar"
            async with asyncio.timeout(60):
                while not lease.over:
                    await lease.changed.wait()
                    lease.changed.clear()
            assert lease.over == "oscar: taken over by erna"
            with pytest.raises(LeaseRefused, match="taken over by erna") as refused:
                await lease.drive([0.1, 0.0])
            assert refused.value.ua_status == StatusCode.BAD_RESOURCE_UNAVAILABLE


async def test_observers_watch_and_do_not_drive(made: Floor) -> None:
    async with connect(made, OBSERVER) as client:
        with pytest.raises(AccessRefused):
            async with driving(client, "carrier"):
                raise AssertionError
        with pytest.raises(NodeNotFound):
            await teleoperation_info(client, "nobody")
        info = await teleoperation_info(client, "carrier")
        seen = False
        async with connect(made, OPERATOR) as operator, driving(operator, "carrier"), asyncio.timeout(60):
            statuses = watch_teleoperation(client, info)
            async for status in statuses:
                seen = status.is_good and status.holder == "oscar" and set(status.drops) == {*DROPS}
                if seen:
                    break
            await statuses.aclose()
        assert seen
