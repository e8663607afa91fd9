"""Whether other programs leave a machine to a benchmark whose figures they would spoil."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Final, NamedTuple

from benchmarks.harness import Unavailable

__all__ = ["CoreTimes", "core_times", "expect_quiet", "problem"]

MOST_BUSY: Final = 0.15
"""Of all cores, by what runs besides this process: on two cores a third of one is the machine's own idling."""
MOST_LOAD: Final = 0.75
"""Of the number of cores: programs that wait for a core, over the last minute. What has just ended is still in it."""
LOOK_S: Final = 2.0


class CoreTimes(NamedTuple):
    """What the cores of a machine have done since it was started, in their ticks together."""

    busy: int
    idle: int


def core_times(stat: str) -> CoreTimes:
    """The sum over all cores, from the text of /proc/stat (proc_stat(5))."""
    user, nice, system, idle, iowait, irq, softirq, steal = map(int, stat.split("\n", 1)[0].split()[1:9])
    return CoreTimes(user + nice + system + irq + softirq + steal, idle + iowait)


def problem(before: CoreTimes, after: CoreTimes, load: float, cores: int) -> str:
    """What keeps a machine from being measured on, in one line; empty where nothing does."""
    passed = sum(after) - sum(before)
    busy = (after.busy - before.busy) / passed if passed else 0.0
    if busy > MOST_BUSY:
        return f"other programs use {busy:.0%} of this machine's {cores} cores, at most {MOST_BUSY:.0%}: end them first"
    if load > MOST_LOAD * cores:
        return f"the load average of the last minute is {load:.2f}, at most {MOST_LOAD * cores:g}: wait, and try again"
    return ""


def expect_quiet() -> None:
    """Look at the machine for `LOOK_S`; this process does nothing meanwhile.

    Raises:
        Unavailable: it is busy, and with what; also where it does not tell (it is no Linux).
    """
    stat = Path("/proc/stat")
    if not stat.exists():
        raise Unavailable("this system does not tell how busy it is (/proc/stat)")
    before = core_times(stat.read_text())
    time.sleep(LOOK_S)
    if found := problem(before, core_times(stat.read_text()), os.getloadavg()[0], os.cpu_count() or 1):
        raise Unavailable(f"nothing is measured or recorded: {found}")
