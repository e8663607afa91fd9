"""What a port did not take has not gone out, and a command waits behind no data.

The first, not even in part: only so is "never begun" true.
"""

from __future__ import annotations

import asyncio
import os
import pty
import threading
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import cast

import pytest
from ua_bridges.plugged import port as port_module
from ua_bridges.plugged.config import SerialSettings
from ua_bridges.plugged.lines import Lines, NewestKey
from ua_bridges.plugged.port import MOST_UNSENT, Port

from ua_fleet.topics import Topic

WAIT_S = 60.0
SPEED, LIGHT = Topic(0, 2, 11), Topic(0, 2, 12)


class Heard:
    """In the place of Lines: that the port was opened and closed, and what did not go out."""

    def __init__(self) -> None:
        self.is_open, self.is_closed = asyncio.Event(), asyncio.Event()
        self.replaced: list[NewestKey] = []
        self.lost: list[NewestKey] = []

    def opened(self, now: float, time_ns: int) -> None:
        self.is_open.set()

    def closed(self, why: str, now: float) -> None:
        self.is_closed.set()

    def overtaken(self, key: NewestKey) -> None:
        self.replaced.append(key)

    def never_sent(self, key: NewestKey) -> None:
        self.lost.append(key)


@asynccontextmanager
async def opened() -> AsyncGenerator[tuple[Port, Heard, int]]:
    device, end = pty.openpty()
    try:
        heard, port = Heard(), Port("mixer", SerialSettings(), lambda: None)
        port.attach(cast("Lines", heard))
        port.plugged(os.ttyname(end))
        async with asyncio.timeout(WAIT_S):
            await heard.is_open.wait()
        yield port, heard, device
        await port.stop()
    finally:
        os.close(device)
        os.close(end)


async def read_until(device: int, last: bytes) -> bytes:
    """What a device reads, in the thread of its own that a device is."""
    got = bytearray()

    def read() -> None:
        while not got.endswith(last):
            got.extend(os.read(device, 4096))

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    await asyncio.to_thread(reader.join, WAIT_S)
    return bytes(got)


async def test_a_command_that_is_not_taken_is_not_sent_in_part() -> None:
    async with opened() as (port, heard, _):
        assert port.write(b"x" * (4 * MOST_UNSENT)), "a part of it has gone out"
        assert not heard.is_closed.is_set()
        assert not port.write(b"y")
        async with asyncio.timeout(WAIT_S):
            await heard.is_closed.wait()


async def test_a_halt_waits_behind_no_data(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel would take 4 KiB of data, for which a line of 9600 baud needs 4 s."""

    def is_free(_descriptor: int) -> bool:
        return False

    monkeypatch.setattr(port_module, "_is_free", is_free)
    async with opened() as (port, heard, device):
        for number in range(2000):
            assert port.write_newest(SPEED, b"SPEED %d\n" % number)
        assert port.write_newest(LIGHT, b"LIGHT 1\n")
        assert port.write_newest(SPEED, b"SPEED 2000\n")
        assert port.write(b"HALT\n")
        assert await read_until(device, b"LIGHT 1\n") == b"HALT\nSPEED 2000\nLIGHT 1\n"
        assert heard.replaced == [SPEED] * 2000
    assert heard.lost == []


async def test_data_waits_for_a_line_that_is_full_and_is_the_newest_then() -> None:
    async with opened() as (port, heard, device):
        assert port.write_newest(SPEED, b"SPEED 0\n"), "at once, since nothing waits"
        assert port.write(b"x" * (2 * MOST_UNSENT) + b"\n")
        for number in range(1, 9):
            assert port.write_newest(SPEED, b"SPEED %d\n" % number)
        got = await read_until(device, b"SPEED 8\n")
        assert got.replace(b"x", b"") == b"SPEED 0\n\nSPEED 8\n"
        assert heard.replaced == [SPEED] * 7


async def test_data_that_waits_when_the_port_is_over_is_counted() -> None:
    async with opened() as (port, heard, _):
        port.write(b"x" * (4 * MOST_UNSENT))
        assert port.write_newest(SPEED, b"SPEED 1\n")
        assert port.write_newest(LIGHT, b"LIGHT 1\n")
        port.unplugged("pulled out")
        assert heard.lost == [SPEED, LIGHT]
        assert not port.write_newest(SPEED, b"SPEED 2\n")


async def test_a_port_whose_other_end_is_gone_is_over() -> None:
    device, end = pty.openpty()
    heard, port = Heard(), Port("mixer", SerialSettings(), lambda: None)
    port.attach(cast("Lines", heard))
    port.plugged(os.ttyname(end))
    async with asyncio.timeout(WAIT_S):
        await heard.is_open.wait()
        os.close(end)
        os.close(device)
        assert not port.write_newest(SPEED, b"SPEED 1\n")
        await heard.is_closed.wait()
    await port.stop()
