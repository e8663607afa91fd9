"""What every attack on a bridge is judged by: its honest neighbours, its memory, and what it says."""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from weakref import WeakKeyDictionary

from tests.integration.peer import Peer
from tests.system import Child
from ua_fleet.topics import Topic
from ua_fleet.values import ticks_from_unix_ns

OLDEST_S = 5.0
"""How old an honest neighbour's value may be while others attack; see `Course.oldest_s`."""
_REMEMBERED_S = 60.0
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


class Starvation:
    """For how long a bridge's threads have waited for a processor: others of this machine take it, and no attack."""

    def __init__(self, bridge: Child) -> None:
        self._tasks = Path(f"/proc/{bridge.process.pid}/task")
        self._seen: deque[tuple[float, dict[str, int]]] = deque()

    def within(self, seconds: float) -> float:
        """How long the thread that waited for longest has waited within the last seconds, as far as was looked."""
        now, waited = time.monotonic(), dict(self._waited_ns())
        self._seen.append((now, waited))
        while self._seen[0][0] < now - _REMEMBERED_S:
            self._seen.popleft()
        since = next((each for at, each in reversed(self._seen) if at <= now - seconds), self._seen[0][1])
        return max((ns - since[name] for name, ns in waited.items() if name in since), default=0) / 1e9

    def _waited_ns(self) -> Iterator[tuple[str, int]]:
        for task in self._tasks.iterdir():
            with contextlib.suppress(OSError):  # it has ended meanwhile
                yield task.name, int((task / "schedstat").read_text().split()[1])


_starvation: WeakKeyDictionary[Child, Starvation] = WeakKeyDictionary()


class Course(NamedTuple):
    """How an honest source, and the bridge, fared while others attacked."""

    oldest_s: float = 0.0
    """How old its value was at most, without the time for which the bridge waited for a processor meanwhile."""
    grown_bytes: int = 0
    """How much more memory the bridge held at most."""

    def or_worse(self, other: Course) -> Course:
        """The worse of both in each respect."""
        return Course(max(self.oldest_s, other.oldest_s), max(self.grown_bytes, other.grown_bytes))


async def goes_on(peer: Peer, topic: Topic, bridge: Child, seconds: float) -> Course:
    """An honest source is carried on, and is of now, for so long; the bridge lives and does not grow without end."""
    seen = len(peer.good(topic))
    course = await goes_on_a_while(peer, topic, bridge, seconds)
    await peer.until(lambda: len(peer.good(topic)) > seen + 3)
    return course


async def goes_on_a_while(peer: Peer, topic: Topic, bridge: Child, seconds: float) -> Course:
    """As `goes_on`, for a time in which perhaps no new value comes."""
    course = Course()
    starvation = _starvation.setdefault(bridge, Starvation(bridge))
    before = memory_bytes(bridge)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        assert bridge.process.poll() is None, "\n".join(bridge.lines[-20:])
        age = age_s(peer, topic)
        course = course.or_worse(Course(age - starvation.within(age), memory_bytes(bridge) - before))
        assert course.oldest_s < OLDEST_S, "\n".join(bridge.lines[-20:])
        assert course.grown_bytes < MOST_GROWTH_BYTES, f"grown by {course.grown_bytes >> 20} MiB"
        await asyncio.sleep(0.1)
    return course
