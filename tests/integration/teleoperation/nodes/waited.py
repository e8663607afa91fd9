"""How long threads of this process have waited for a core of the machine since they began: Linux's own record.

Needs nothing but Python, so that programs of both ROS environments have it.
"""

import threading
import time
from pathlib import Path


def waited(*native_ids: int | None) -> str:
    """`waited TIME THREAD=SECONDS ...`, of these threads, or of all that Python knows."""
    threads = native_ids or [thread.native_id for thread in threading.enumerate()]
    told = ["waited", str(time.monotonic())]
    for thread in threads:
        try:
            # /proc/.../schedstat: ns on a core, ns that it was runnable and had none, count of turns
            _, waiting_ns, _ = Path(f"/proc/self/task/{thread}/schedstat").read_text().split()
        except OSError:  # it has just ended, or this system has no such record
            continue
        told.append(f"{thread}={int(waiting_ns) / 1e9}")
    return " ".join(told)
