"""What a connection did not take has not gone out, not even in part: only so is "never begun" true."""

from __future__ import annotations

import asyncio
import socket

from ua_bridges.tcp.link import MOST_UNSENT, Link

from tests.contract.harness import Recorder
from ua_fleet.bridge.offenders import Offenders

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
