"""A bridge that says when it publishes each counter, by the clock of all processes: `bridge.py FLEET_JSON BRIDGE`.

And how long its loop's thread has waited for a core by then.

So the age of a wish is judged by what the bridge itself did, and not by when the operator's device heard of it.
"""

from __future__ import annotations

import os
import runpy
import time
from collections.abc import Callable
from pathlib import Path

from ua_fleet.teleoperation.watch import Echoes

_INTEGRATION = Path(__file__).parents[2] / "integration"
_waited: Callable[..., str] = runpy.run_path(str(_INTEGRATION / "teleoperation" / "nodes" / "waited.py"))["waited"]

_count = Echoes.count


def count(self: Echoes, now: float) -> int:
    counter = _count(self, now)
    print("counter", counter, time.monotonic(), flush=True)
    print(_waited(os.getpid()), flush=True)
    return counter


Echoes.count = count  # type: ignore[method-assign]
runpy.run_path(str(_INTEGRATION / "run_bridge.py"), run_name="__main__")
