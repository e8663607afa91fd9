"""A controller of Universal Robots that misbehaves takes neither the memory of the machine nor the bridge."""

from __future__ import annotations

import asyncio
import os
import resource
import socket
import struct
import time
from pathlib import Path

import pytest
from ua_bridges.ur.driver import create_driver

from tests.attacks.servers import Serve, endless, hostile, silent, slow
from tests.contract.harness import Recorder
from tests.ur_controller import free_loopback
from tests.waiting import until
from ua_fleet.config.load import load_content
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic

pytestmark = pytest.mark.needs("ur")

FLEET = """
version: 1
pubsub: {security: none}
bridges:
  arm: {kind: ur, space: 300, status_id: 1, address: HOST, retry_s: [0.1, 0.2], answer_timeout_s: 1.5}
robots:
  ur5:
    bridge: arm
    data: {number: {id: 11, type: Double, path: output_double_register_12, source: {}}}
"""
NUMBER = Topic(300, 2, 11)
MOST_CHILD_BYTES = 400 << 20


def frame(kind: bytes, body: bytes) -> bytes:
    """A package of RTDE."""
    return struct.pack(">Hc", len(body) + 3, kind) + body


def vanishing(link: socket.socket) -> None:
    """Go after the first request."""
    link.recv(100)


def say(content: bytes) -> Serve:
    """Answer that, and then nothing."""

    def serve(link: socket.socket) -> None:
        link.recv(100)
        link.sendall(content)
        silent(link)

    return serve


KINDS: dict[str, tuple[Serve, bool]] = {
    "silent": (silent, False),
    "endless": (endless(b"\xff" * 65536), True),
    "zeros": (endless(b"\0" * 65536), True),
    "packages_of_no_length": (endless(struct.pack(">Hc", 0, b"V") * 1000), True),
    "a_length_that_is_a_lie": (say(struct.pack(">Hc", 65535, b"V") + b"x" * 100), True),
    "messages_without_end": (endless(frame(b"M", b"\xc8hello") * 1000), False),
    "slow": (slow(frame(b"V", b"\x01"), 0.5), False),
    "vanishing": (vanishing, False),
}
"""Each with whether it is put aside."""


def children() -> dict[int, int]:
    """The memory of each process that this one has started, in bytes. One that has not come to its program yet shows
    the memory of this one, and counts as none."""
    held: dict[int, int] = {}
    ours = Path("/proc/self/cmdline").read_bytes()
    for folder in Path("/proc").iterdir():
        try:
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == os.getpid():
                pages = int((folder / "statm").read_text().split()[1])
                has_begun = (folder / "cmdline").read_bytes() != ours
                held[int(folder.name)] = pages * resource.getpagesize() if has_begun else 0
        except (OSError, IndexError, ValueError):
            continue
    return held


@pytest.mark.parametrize("kind", KINDS)
async def test_a_controller_that_misbehaves_costs_itself(kind: str) -> None:
    serve, is_put_aside = KINDS[kind]
    before = children().keys()  # what other tests have left to those behind them
    host = free_loopback()
    with hostile(serve, address=(host, 30004)):
        driver = create_driver(load_content(FLEET.replace("HOST", host).encode(), "f.yaml", {}), "arm")
        recorder = Recorder()
        await driver.start(recorder)
        try:
            end = time.monotonic() + 2.0
            while time.monotonic() < end or (
                is_put_aside and not driver.status().aside and time.monotonic() < end + 20
            ):
                await asyncio.sleep(0.05)
                assert sum(held for pid, held in children().items() if pid not in before) < MOST_CHILD_BYTES
            status = driver.status()
            assert not status.connected
            assert not status.is_over
            assert "\n" not in status.detail
            assert recorder.samples(NUMBER) == []
            assert bool(status.aside) == is_put_aside
            assert bool(recorder.dropped(Drop.MISBEHAVED)) == is_put_aside
        finally:
            await driver.stop()
    await until(lambda: children().keys() <= before, "the end of its children")
