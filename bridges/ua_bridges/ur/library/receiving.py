"""The child that reads the robot's state: `python -m ua_bridges.ur.library.receiving HOST HZ PRIORITY VARIABLES`.

The library keeps the last sample only, so it is looked at more often than samples come; one that was replaced unseen
shows as a gap in the controller's time, and is counted. PRIORITY, where it is not 0, is the one of SCHED_FIFO.

A line `{"note": ".."}` comes before it connects, with what could not be had. Each sample is a line
`[received_s, lost, timestamp, {name: value}]`; what ends it is a line `{"error": ".."}`. VARIABLES is a JSON object:
name in RTDE to the library's method and its arguments.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any, Final

from ua_bridges.ur.library.lines import Output, bound_memory, end_with_parent, open_output

_LOOK_S: Final = 0.0002
_EARLY_S: Final = 0.0015
"""The next sample is looked for from so long before it is due: one that was late is followed sooner by the next."""
_MOST_READS: Final = 5


def _run(output: Output, host: str, frequency: float, variables: dict[str, list[Any]], note: str) -> None:
    library: Any = importlib.import_module("rtde_receive")  # it has no types
    output.say({"note": note})
    client = library.RTDEReceiveInterface(host, frequency, sorted({"timestamp", *variables}))
    readers: list[tuple[str, Callable[..., Any], list[Any]]] = [
        (name, getattr(client, getter), arguments) for name, (getter, *arguments) in variables.items()
    ]
    read_time, is_connected = client.getTimestamp, client.isConnected
    period = 1 / frequency
    last: float | None = None
    due = 0.0
    while is_connected():
        wait = due - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        stamp: float = read_time()
        if stamp == last or stamp == 0.0:
            time.sleep(_LOOK_S)
            continue
        received_s = time.monotonic()
        due = time.monotonic() + max(period - _EARLY_S, period / 4)
        values: dict[str, Any] = {}
        for _ in range(_MOST_READS):  # again where the next sample came in between
            values = {name: read(*arguments) for name, read, arguments in readers}
            after: float = read_time()
            if after == stamp:
                break
            stamp = after
        lost = 0 if last is None or stamp < last else max(round((stamp - last) / period) - 1, 0)
        last = stamp
        output.say([received_s, lost, stamp, values])
    output.say({"error": "the controller closed the connection"})


def _take_priority(priority: int) -> str:
    """Ask the kernel for it; why not, or the empty text."""
    try:
        if priority:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        return f"real_time_priority: {error.strerror}; give the bridge CAP_SYS_NICE, or leave it out"
    return ""


def main(arguments: list[str]) -> int:
    """Read until the connection ends; the exit code."""
    output = open_output()
    end_with_parent()
    bound_memory()
    host, frequency, priority, variables = arguments
    try:
        _run(output, host, float(frequency), json.loads(variables), _take_priority(int(priority)))
    except BrokenPipeError:
        return 0
    except (RuntimeError, ImportError, ValueError, OSError) as error:
        output.say({"error": str(error)})
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
