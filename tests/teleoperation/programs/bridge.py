"""A bridge that says when it publishes each counter, by the clock of all processes: `bridge.py FLEET_JSON BRIDGE`.

So the age of a wish is judged by what the bridge itself did, and not by when the operator's device heard of it.
"""

from __future__ import annotations

import runpy
import time
from pathlib import Path

from ua_fleet.teleoperation.watch import Echoes

_count = Echoes.count


def count(self: Echoes, now: float) -> int:
    counter = _count(self, now)
    print("counter", counter, time.monotonic(), flush=True)
    return counter


Echoes.count = count  # type: ignore[method-assign]
runpy.run_path(str(Path(__file__).parents[2] / "integration" / "run_bridge.py"), run_name="__main__")
