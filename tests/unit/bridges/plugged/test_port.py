"""What a port did not take has not gone out, not even in part: only so is "never begun" true."""

from __future__ import annotations

import asyncio
import os
import pty
from typing import cast

from ua_bridges.plugged.config import SerialSettings
from ua_bridges.plugged.lines import Lines
from ua_bridges.plugged.port import MOST_UNSENT, Port

WAIT_S = 60.0


class Heard:
    """In the place of Lines: that the port was opened and closed."""

    def __init__(self) -> None:
        self.is_open, self.is_closed = asyncio.Event(), asyncio.Event()

    def opened(self, now: float, time_ns: int) -> None:
        self.is_open.set()

    def closed(self, why: str, now: float) -> None:
        self.is_closed.set()


async def test_a_command_that_is_not_taken_is_not_sent_in_part() -> None:
    device, end = pty.openpty()
    try:
        heard, port = Heard(), Port("mixer", SerialSettings(), lambda: None)
        port.attach(cast("Lines", heard))
        port.plugged(os.ttyname(end))
        async with asyncio.timeout(WAIT_S):
            await heard.is_open.wait()
        assert port.write(b"x" * (4 * MOST_UNSENT)), "a part of it has gone out"
        assert not heard.is_closed.is_set()
        assert not port.write(b"y")
        async with asyncio.timeout(WAIT_S):
            await heard.is_closed.wait()
        await port.stop()
    finally:
        os.close(device)
        os.close(end)
