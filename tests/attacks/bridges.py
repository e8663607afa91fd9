"""What every attack on a bridge is judged by: its honest neighbours, its memory, and what it says."""

from __future__ import annotations

import asyncio
import os
import resource
import time
from pathlib import Path

from tests.integration.peer import Peer
from tests.system import Child
from ua_fleet.topics import Topic
from ua_fleet.values import ticks_from_unix_ns

OLDEST_S = 5.0
"""How old an honest neighbour's value may be while others attack, on a machine that does much else."""
MOST_GROWTH_BYTES = 600 << 20


def limit_memory(bridge: Child, most_bytes: int = 6 << 30) -> None:
    """Have the kernel refuse the bridge more memory, before the machine has none."""
    resource.prlimit(bridge.process.pid, resource.RLIMIT_AS, (most_bytes, most_bytes))


def memory_bytes(bridge: Child) -> int:
    """The memory that the bridge's process holds now."""
    pages = int(Path(f"/proc/{bridge.process.pid}/statm").read_text().split()[1])
    return pages * resource.getpagesize()


def age_s(peer: Peer, topic: Topic) -> float:
    """How old the last good value of a source is."""
    last = next((each for each in reversed(peer.messages(topic)) if not each.status), None)
    if last is None or last.timestamp is None:
        return float("inf")
    ticks: int = ticks_from_unix_ns(time.time_ns()) - last.timestamp
    return ticks / 1e7


def cpu_s(bridge: Child) -> float:
    """The seconds of a processor that the bridge's process has taken."""
    fields = Path(f"/proc/{bridge.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def cpu_share(bridge: Child, seconds: float) -> float:
    """The part of a processor that the bridge's process takes now."""
    before, began = cpu_s(bridge), time.monotonic()
    await asyncio.sleep(seconds)
    return (cpu_s(bridge) - before) / (time.monotonic() - began)


def threads(bridge: Child) -> int:
    """How many threads the bridge's process has."""
    return len(list(Path(f"/proc/{bridge.process.pid}/task").iterdir()))


async def goes_on(peer: Peer, topic: Topic, bridge: Child, seconds: float) -> None:
    """An honest source is carried on, and is of now, for so long; the bridge lives and does not grow without end."""
    seen = len(peer.good(topic))
    await goes_on_a_while(peer, topic, bridge, seconds)
    await peer.until(lambda: len(peer.good(topic)) > seen + 3)


async def goes_on_a_while(peer: Peer, topic: Topic, bridge: Child, seconds: float) -> None:
    """As `goes_on`, for a time in which perhaps no new value comes."""
    before = memory_bytes(bridge)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        assert bridge.process.poll() is None, "\n".join(bridge.lines[-20:])
        assert age_s(peer, topic) < OLDEST_S, "\n".join(bridge.lines[-20:])
        grown = memory_bytes(bridge) - before
        assert grown < MOST_GROWTH_BYTES, f"grown by {grown >> 20} MiB"
        await asyncio.sleep(0.1)
