"""What a connection did not take has not gone out, not even in part: only so is "never begun" true.

Where the robot connects to us, nobody else is let in.
"""

from __future__ import annotations

import asyncio
import socket
from contextlib import closing

import pytest
from ua_bridges.tcp.link import MOST_STRANGERS, MOST_UNSENT, Link

from tests.contract.harness import Recorder
from tests.system import free_tcp_port
from ua_fleet.bridge.driver import Dropped
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.counters import Drop

WAIT_S = 60.0


class Session:
    """Listens, and says nothing."""

    def __init__(self) -> None:
        self.is_up, self.is_lost = asyncio.Event(), asyncio.Event()

    def connected(self, now: float) -> None:
        self.is_up.set()

    def lost(self, now: float) -> None:
        self.is_lost.set()

    def received(self, data: bytes, now: float, time_ns: int) -> None:
        """Nothing is sent."""

    def turn(self, now: float) -> float | None:
        return None


def read_all(robot: socket.socket) -> bytes:
    """What a robot reads until the connection ends."""
    robot.settimeout(WAIT_S)
    parts: list[bytes] = []
    while True:
        try:
            part = robot.recv(1 << 16)
        except ConnectionResetError:
            break
        if not part:
            break
        parts.append(part)
    return b"".join(parts)


async def test_a_message_that_is_not_taken_is_not_sent_in_part() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        session = Session()
        link = Link("robot", Offenders(Recorder()), f"127.0.0.1:{server.getsockname()[1]}")
        link.start(session)
        robot, _ = await asyncio.get_running_loop().sock_accept(server)
        async with asyncio.timeout(WAIT_S):
            await session.is_up.wait()
        with robot:
            large, late = b"x" * (32 * MOST_UNSENT), b"y" * MOST_UNSENT  # far more than any system takes at once
            assert link.write(large), "a part of it has gone out"
            assert not link.write(late)
            async with asyncio.timeout(WAIT_S):
                await session.is_lost.wait()
            link.stop()
            received = await asyncio.to_thread(read_all, robot)
        assert 0 < len(received) < len(large)
        assert set(received) == {ord("x")}


async def knock(port: int, source: str = "127.0.0.1") -> None:
    """Connect from an address, and be hung up on."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=(source, 0))
    with closing(writer):
        assert await asyncio.wait_for(reader.read(), WAIT_S) == b""


@pytest.mark.parametrize(
    ("host", "peer"),
    [("127.0.0.1", "127.0.0.1"), ("127.0.0.1", "::ffff:127.0.0.1"), ("::1", "::1"), ("::1", "0:0:0:0:0:0:0:1")],
)
async def test_the_robot_is_let_in_however_its_address_is_written(host: str, peer: str) -> None:
    try:
        with socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET) as server:
            port = server.getsockname()[1]
    except OSError:
        pytest.skip(f"this machine has no {host}")
    session = Session()
    link = Link("robot", Offenders(Recorder()), None, f"[{host}]:{port}" if ":" in host else f"{host}:{port}", peer)
    link.start(session)
    _, writer = await asyncio.open_connection(host, port)
    with closing(writer):
        await asyncio.wait_for(session.is_up.wait(), WAIT_S)
        assert link.detail == f"{peer} is connected"
    link.stop()


async def test_who_is_refused_is_counted_and_told_once() -> None:
    port, told = free_tcp_port(), Recorder()
    link = Link("robot", Offenders(told), None, f"127.0.0.1:{port}", "127.0.0.9", told.put)
    link.start(Session())
    await knock(port)
    refused = Dropped(Drop.UNKNOWN_SOURCE, 1, "robot: refused a connection from 127.0.0.1; only 127.0.0.9 may connect")
    assert told.events == [refused]
    assert link.detail == (
        f"waiting on 127.0.0.1:{port} for the robot's program; start it; "
        "connections refused, since only 127.0.0.9 may connect: 1, the last from 127.0.0.1"
    )
    for number in range(MOST_STRANGERS):
        await knock(port, f"127.0.1.{number}")
    await knock(port)
    assert told.events[-2:] == [Dropped(Drop.UNKNOWN_SOURCE), refused], "more addresses than these are counted alone"
    assert f"may connect: {MOST_STRANGERS + 2}, the last from 127.0.0.1" in link.detail
    link.stop()
