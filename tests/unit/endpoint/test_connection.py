"""A connection without a socket: what is processed at once, and when its task begins."""

from __future__ import annotations

import asyncio
import gc
import struct
import weakref
from collections.abc import Callable
from typing import Any

import pytest

from ua_fleet.endpoint.connection import FrameError, TcpConnection
from ua_fleet.endpoint.limits import CHUNK_BYTES

pytestmark = pytest.mark.asyncio


def frame(kind: bytes, body: bytes = b"body") -> bytes:
    return kind + b"F" + struct.pack("<I", 8 + len(body)) + body


HELLO, OPEN, MESSAGE = frame(b"HEL"), frame(b"OPN", b"opening"), frame(b"MSG", b"request")


class Transport(asyncio.Transport):
    def __init__(self) -> None:
        super().__init__({"peername": ("192.0.2.1", 4000)})
        self.closed = False

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def close(self) -> None:
        self.closed = True

    def abort(self) -> None:
        self.closed = True

    def is_closing(self) -> bool:
        return self.closed

    def pause_reading(self) -> None:
        pass

    def resume_reading(self) -> None:
        pass


class Handler:
    def __init__(self) -> None:
        self.seen: list[str] = []
        self.failure: Callable[[], Exception] | None = None

    def room(self) -> int:
        return CHUNK_BYTES

    def process_opening(self, data: bytes) -> None:
        self.seen.append(f"at once {data[:3].decode()}")
        if self.failure is not None:
            raise self.failure()

    async def process(self, data: bytes) -> bool:
        self.seen.append(f"in the task {data[:3].decode()}")
        if self.failure is not None:
            raise self.failure()
        return True

    def refuse(self, error: FrameError) -> None:
        self.seen.append(f"refused {error}")

    async def closed(self) -> None:
        self.seen.append("closed")


class Wired:
    """A connection whose peer sends what a test says."""

    def __init__(self) -> None:
        self.handler = Handler()
        self.tasks = tasks = list[asyncio.Task[None]]()
        handler: Any = self.handler
        self.connection = TcpConnection(lambda _: True, lambda _: handler, lambda _, task: tasks.append(task))
        self.transport = Transport()
        self.connection.connection_made(self.transport)

    def receive(self, data: bytes) -> None:
        room = self.connection.get_buffer(-1)
        room[: len(data)] = data
        self.connection.buffer_updated(len(data))

    async def lost(self) -> list[str]:
        """What was seen, to the end of the connection."""
        self.connection.connection_lost(None)
        await asyncio.gather(*self.tasks, return_exceptions=True)
        assert len(self.tasks) == 1
        return self.handler.seen


async def test_hello_and_opening_are_processed_when_they_come_and_a_request_in_the_task() -> None:
    wired = Wired()
    wired.receive(HELLO)
    wired.receive(OPEN)
    assert wired.handler.seen == ["at once HEL", "at once OPN"]
    assert not wired.tasks
    wired.receive(MESSAGE)
    assert len(wired.tasks) == 1
    await asyncio.sleep(0)
    assert wired.handler.seen[2:] == ["in the task MSG"]
    wired.receive(OPEN)
    await asyncio.sleep(0)
    assert wired.handler.seen[3:] == ["in the task OPN"]
    assert await wired.lost() == ["at once HEL", "at once OPN", "in the task MSG", "in the task OPN", "closed"]


@pytest.mark.parametrize("sizes", [(1,), (3, 5), (7,), (8, 1), (11,)])
async def test_frames_in_pieces(sizes: tuple[int, ...]) -> None:
    wired, data = Wired(), HELLO + OPEN + MESSAGE
    at = turn = 0
    while at < len(data):
        size = sizes[turn % len(sizes)]
        wired.receive(data[at : at + size])
        at, turn = at + size, turn + 1
        await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert [each[-3:] for each in wired.handler.seen] == ["HEL", "OPN", "MSG"]
    assert (await wired.lost())[-1] == "closed"


async def test_of_frames_that_come_together_one_is_processed_at_once() -> None:
    """The others wait for their turn, as those of everybody."""
    wired = Wired()
    wired.receive(HELLO + OPEN + MESSAGE)
    assert wired.handler.seen == ["at once HEL"]
    await asyncio.sleep(0)
    assert wired.handler.seen[1:] == ["in the task OPN", "in the task MSG"]
    await wired.lost()


async def test_only_the_first_two_are_processed_at_once() -> None:
    """Who opens again and again waits until he has taken his responses, as with requests."""
    wired = Wired()
    for _ in range(3):
        wired.receive(OPEN)
    assert wired.handler.seen == ["at once OPN"] * 2
    assert len(wired.tasks) == 1
    await wired.lost()


@pytest.mark.parametrize("data", [b"GET / HTTP/1.1\r\n", HELLO[:4] + b"\xff\xff\xff\x7f"])
async def test_what_is_no_frame_is_refused_by_the_task(data: bytes) -> None:
    wired = Wired()
    wired.receive(data)
    await asyncio.gather(*wired.tasks)
    assert wired.transport.closed
    refusal, closed = wired.handler.seen
    assert refusal.startswith("refused")
    assert closed == "closed"


async def test_a_refused_opening_ends_the_connection_and_leaves_no_garbage() -> None:
    wired = Wired()
    wired.receive(HELLO)
    wired.handler.failure = lambda: FrameError(1, "not so")
    gc.collect()
    gc.disable()
    try:
        wired.receive(OPEN)
        await asyncio.gather(*wired.tasks)
        assert wired.handler.seen == ["at once HEL", "at once OPN", "refused not so", "closed"]
        assert wired.transport.closed
        held = weakref.ref(wired.connection)
        del wired
        # A connection has a buffer of 64 KiB, and many of those who are refused come again at once.
        assert held() is None
    finally:
        gc.enable()


@pytest.mark.parametrize("ends", ["lost", "cut off", "refused"])
async def test_an_ended_connection_has_no_buffer_while_something_still_refers_to_it(ends: str) -> None:
    """What stands behind it refers to itself, and stays until garbage is collected: 9,000 buffers took 595 MB."""
    wired = Wired()
    wired.receive(HELLO)
    assert len(wired.connection.get_buffer(-1)) == CHUNK_BYTES
    if ends == "lost":
        wired.connection.connection_lost(None)
    elif ends == "cut off":
        wired.connection.abort()
    else:
        wired.receive(frame(b"GET"))
    await asyncio.gather(*wired.tasks)
    assert len(wired.connection.get_buffer(-1)) == 0


async def test_a_mistake_of_ours_is_the_tasks() -> None:
    wired = Wired()
    wired.handler.failure = ZeroDivisionError
    wired.receive(HELLO)
    with pytest.raises(ZeroDivisionError):
        await wired.tasks[0]
    assert wired.handler.seen == ["at once HEL", "closed"]
    assert wired.transport.closed


@pytest.mark.parametrize("before", [b"", HELLO, HELLO[:5]])
async def test_a_connection_that_is_lost_or_cut_off_before_a_request_is_closed(before: bytes) -> None:
    lost, cut = Wired(), Wired()
    for wired in (lost, cut):
        if before:
            wired.receive(before)
    assert (await lost.lost())[-1] == "closed"
    cut.connection.abort()
    await asyncio.gather(*cut.tasks)
    assert cut.handler.seen[-1] == "closed"
