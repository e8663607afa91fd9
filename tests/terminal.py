"""A program on a terminal of its own, as a person has it before them: Ctrl-C reaches all of its processes."""

from __future__ import annotations

import os
import pty
import select
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, NoReturn

__all__ = ["CTRL_C", "Ended", "typed_after"]

CTRL_C = b"\x03"


class Ended(NamedTuple):
    """How it ended."""

    code: int
    """Its exit code; minus the signal that ended it."""
    shown: str
    """All that stood on the terminal."""
    after_s: float
    """So long after what was typed."""


def typed_after(
    command: Sequence[str],
    shown: str,
    typed: bytes,
    *,
    folder: Path,
    environment: Mapping[str, str],
    delay_s: float = 0.0,
    timeout_s: float = 120.0,
) -> Ended:
    """Run a program, type something once it has shown a text, and wait for its end.

    Args:
        command: program and arguments.
        shown: the text.
        typed: what is typed.
        folder: where it is run.
        environment: all of its variables.
        delay_s: so long after the text it is typed.
        timeout_s: longest time for all of it.
    """
    pid, terminal = pty.fork()
    if pid == 0:
        _become(command, folder, environment)
    seen, typed_at, end = "", 0.0, time.monotonic() + timeout_s
    try:
        while True:
            left = end - time.monotonic()
            assert left > 0, f"after {timeout_s:g} s there was only:\n{seen}"
            if not select.select([terminal], [], [], min(left, 0.1))[0]:
                continue
            try:
                piece = os.read(terminal, 65536)
            except OSError:  # the other end is closed
                break
            if not piece:
                break
            seen += piece.decode(errors="replace")
            if not typed_at and shown in seen:
                time.sleep(delay_s)
                os.write(terminal, typed)
                typed_at = time.monotonic()
    finally:
        os.close(terminal)  # a hang-up: whatever is left of it ends
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    assert typed_at, f"it ended with {code} before it had shown {shown!r}:\n{seen}"
    return Ended(code, seen, time.monotonic() - typed_at)


def _become(command: Sequence[str], folder: Path, environment: Mapping[str, str]) -> NoReturn:
    try:
        os.chdir(folder)
        os.execvpe(command[0], list(command), dict(environment))
    finally:
        os._exit(127)
