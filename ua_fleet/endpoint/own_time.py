"""Computing time of a thread without the garbage collections that fell into it.

Python collects garbage in the thread that happens to allocate next, and takes seconds of it where much is alive. Who is
charged for what a request costs must not pay for that.
"""

from __future__ import annotations

import gc
import threading
import time
from typing import Any

__all__ = ["own_time"]


class _Collected(threading.local):
    """What collections have taken in one thread, in seconds of computing."""

    seconds = 0.0
    began = 0.0


_collected = _Collected()


def _collecting(phase: str, _info: dict[str, Any]) -> None:
    if phase == "start":
        _collected.began = time.thread_time()
    else:
        _collected.seconds += time.thread_time() - _collected.began


gc.callbacks.append(_collecting)


def own_time() -> float:
    """Seconds of computing of the calling thread, without those in which garbage was collected; for differences."""
    return time.thread_time() - _collected.seconds
