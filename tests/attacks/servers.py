"""A server in the place of a robot's, which does what an attacker wants, and how an honest neighbour is judged."""

from __future__ import annotations

import asyncio
import contextlib
import resource
import socket
import ssl
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

from tests.contract.harness import Recorder
from ua_fleet.topics import Topic

__all__ = ["Serve", "endless", "goes_on", "hostile", "memory_bytes", "silent", "slow"]

OLDEST_S = 5.0
"""How long an honest neighbour may say nothing new while others attack, on a machine that does much else."""
MOST_GROWTH_BYTES = 200 << 20

Serve = Callable[[socket.socket], None]


def silent(link: socket.socket) -> None:
    """Take what comes and say nothing."""
    while link.recv(1 << 16):
        pass


def endless(content: bytes) -> Serve:
    """Say that for ever, asked or not."""

    def serve(link: socket.socket) -> None:
        while True:
            link.sendall(content)

    return serve


def slow(content: bytes, pause_s: float = 0.2) -> Serve:
    """Say that byte by byte, and then nothing."""

    def serve(link: socket.socket) -> None:
        for at in range(len(content)):
            link.sendall(content[at : at + 1])
            time.sleep(pause_s)
        silent(link)

    return serve


@contextmanager
def hostile(
    serve: Serve, context: ssl.SSLContext | None = None, address: tuple[str, int] | None = None
) -> Generator[int]:
    """A server that does that to each who connects; its port."""
    links: list[socket.socket] = []

    def meet(link: socket.socket) -> None:
        with contextlib.suppress(OSError, ValueError):
            if context is not None:
                link.settimeout(5)
                link = context.wrap_socket(link, server_side=True)
                link.settimeout(None)
            with link:
                serve(link)

    def accept() -> None:
        with contextlib.suppress(OSError):
            while True:
                link, _ = listener.accept()
                links.append(link)
                threading.Thread(target=meet, args=(link,), daemon=True).start()

    with socket.create_server(address or ("127.0.0.1", 0)) as listener:
        threading.Thread(target=accept, daemon=True).start()
        yield listener.getsockname()[1]
        listener.shutdown(socket.SHUT_RDWR)
    for link in links:
        with contextlib.suppress(OSError):
            link.shutdown(socket.SHUT_RDWR)


def memory_bytes() -> int:
    """Of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


async def goes_on(recorder: Recorder, honest: Topic, seconds: float) -> None:
    """The honest source is read all the time, and the process does not grow without end."""
    before, end = memory_bytes(), time.monotonic() + seconds
    last, seen = time.monotonic(), len(recorder.samples(honest))
    while time.monotonic() < end:
        await asyncio.sleep(0.05)
        if (now := len(recorder.samples(honest))) > seen:
            seen, last = now, time.monotonic()
        assert time.monotonic() - last < OLDEST_S
        assert memory_bytes() - before < MOST_GROWTH_BYTES
