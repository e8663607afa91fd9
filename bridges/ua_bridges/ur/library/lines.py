"""What the children share: JSON lines out on a pipe of their own, and an end with the bridge."""

from __future__ import annotations

import ctypes
import json
import os
import signal
from typing import Any, Final

__all__ = ["end_with_parent", "open_output"]

_PR_SET_PDEATHSIG: Final = 1


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
