"""What the children share: JSON lines out on a pipe of their own, an end with the bridge, and a bound of memory."""

from __future__ import annotations

import ctypes
import json
import os
import resource
import signal
from typing import Any, Final

__all__ = ["bound_memory", "end_with_parent", "open_output"]

_PR_SET_PDEATHSIG: Final = 1
MOST_DATA_BYTES: Final = 256 << 20
"""Ten times what ur-rtde needs; it keeps what a controller sends and it cannot read."""


class Output:
    """The pipe to the bridge."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def say(self, thing: Any) -> None:
        """One line."""
        data = json.dumps(thing).encode() + b"\n"
        while data:
            data = data[os.write(self._descriptor, data) :]


def open_output() -> Output:
    """The pipe, under another number: ur-rtde itself writes to standard output, which goes to standard error now."""
    descriptor = os.dup(1)
    os.dup2(2, 1)
    return Output(descriptor)


def end_with_parent() -> None:
    """Have the kernel end this process when the bridge ends, also while the library waits for ever."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def bound_memory() -> None:
    """Have the kernel refuse this process more memory, before the machine has none."""
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_DATA_BYTES, MOST_DATA_BYTES))
