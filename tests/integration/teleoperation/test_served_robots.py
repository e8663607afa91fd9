"""A robot of rclpy is driven through a server and a bridge that are processes of their own; the server is killed."""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import AsyncGenerator
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from typing import Any, Final

import pytest

from tests.integration.server_model.harness import OPERATOR
from tests.integration.teleoperation.conftest import PERIOD_S, SPEED, STOP_S, Hall
from tests.integration.teleoperation.driving import WAIT_S
from tests.integration.teleoperation.test_stops import SECURED, SLACK_S, stands, stop_of
from tests.system import ROOT, Child, Processes
from ua_fleet.client import ClientIdentity, DrivingLease, FleetClient, driving, teleoperation_info, watch_teleoperation
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.errors import LeaseRefused, UaFleetError

SERVER: Final = ROOT / "tests" / "integration" / "run_server.py"
DEADMAN_S: Final = 1.0
"""Longer than usual: several processes share two cores with other tests."""


class Served:
    """A hall with a server."""

    def __init__(self, hall: Hall, port: int, processes: Processes) -> None:
        self.hall, self._processes = hall, processes
        self.url = f"opc.tcp://127.0.0.1:{port}/ua_fleet"

    def start_server(self) -> Child:
        child = self._processes.fork(SERVER, self.hall.folder / "fleet.json")
        child.wait_for("opc.tcp://")
        return child

    def client(self) -> AbstractAsyncContextManager[FleetClient]:
        identity = ClientIdentity(self.hall.folder / "identity")
        return FleetClient.connect(self.url, user=OPERATOR[0], password=OPERATOR[1], identity=identity, timeout_s=30)


@pytest.fixture
def served(hall: Hall, tcp_port: int, processes: Processes) -> Served:
    users = UserStore(hall.folder / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.path.parent.mkdir(parents=True, exist_ok=True)
    users.add(*OPERATOR, Role.OPERATOR)
    return Served(hall, tcp_port, processes)


def fleet(hall: Hall, served: Served, **pubsub: Any) -> None:
    port = int(served.url.rpartition(":")[2].partition("/")[0])
    hall.fleet(server={"port": port, "trust_all_clients": True}, deadman_s=DEADMAN_S, **pubsub)


async def idle(client: FleetClient) -> str:
    """Wait until nobody holds the robot, and it stands; why the last lease has ended."""
    info = await teleoperation_info(client, "carrier")
    statuses = watch_teleoperation(client, info)
    async with asyncio.timeout(WAIT_S):
        async for status in statuses:
            if status.is_good and status.state == "Idle" and not status.lease:
                break
    await statuses.aclose()
    return str((await client.read(info.variable("LastEnd"))).value)


@asynccontextmanager
async def first_driving(client: FleetClient) -> AsyncGenerator[DrivingLease]:
    """`driving` behind a server that has begun: its bridge may not have announced yet that the robot can be driven."""
    async with AsyncExitStack() as held:
        async with asyncio.timeout(WAIT_S):
            while True:
                try:
                    lease = await held.enter_async_context(driving(client, "carrier"))
                except LeaseRefused as error:
                    if "no bridge announces the Action" not in str(error):
                        raise
                    await asyncio.sleep(0.05)
                else:
                    break
        yield lease


async def full_speed(lease: DrivingLease) -> None:
    """Drive until the bridge has the robot at full speed."""
    async with asyncio.timeout(WAIT_S):
        while not lease.status.output or lease.status.output[0] < SPEED - 0.001:
            assert not lease.over, lease.over
            await lease.drive({"linear": SPEED})
            await asyncio.sleep(0.02)


@pytest.mark.parametrize("pubsub", [{}, SECURED], ids=["open", "secured"])
async def test_a_robot_is_driven_and_a_server_that_is_killed_stops_it(
    hall: Hall, served: Served, pubsub: dict[str, Any]
) -> None:
    fleet(hall, served, **pubsub)
    hall.start_robot()
    hall.start_bridge()
    server = served.start_server()
    async with served.client() as client:
        await idle(client)
        async with first_driving(client) as lease:
            await full_speed(lease)
            first = lease.number
            assert hall.speeds()[-1].linear == pytest.approx(SPEED)
        released = time.monotonic()
        assert await idle(client) == f"{OPERATOR[0]}: released"
        await stands(hall, released - 1)

        last = 0.0
        with pytest.raises(UaFleetError):  # noqa: PT012 - until the connection is seen to be lost
            async with driving(client, "carrier") as lease:
                await full_speed(lease)
                last = time.monotonic()
                server.end(signal.SIGKILL)
                while True:
                    await lease.drive({"linear": SPEED})
        await hall.until(lambda speeds: speeds[-1].at > last and not speeds[-1].linear, "heard")
        began, ended = await stop_of(hall, last)
        assert began - last < DEADMAN_S + PERIOD_S + SLACK_S
        assert ended - began < STOP_S + 3 * PERIOD_S + SLACK_S
        await stands(hall, last)

    served.start_server()
    async with served.client() as client:
        assert await idle(client) == f"{OPERATOR[0]}: no setpoint was fresh for 1000 ms"
        async with first_driving(client) as lease:
            assert lease.number > first + 1
            await full_speed(lease)
