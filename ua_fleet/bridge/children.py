"""Child processes of a launcher: in a session of their own, so that Ctrl-C is the launcher's, and ended with it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import signal
from asyncio.subprocess import Process
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Final

__all__ = ["LONGEST_LINE_BYTES", "end_child", "how_it_ended", "start_child"]

LONGEST_LINE_BYTES: Final = 1024 * 1024
_PATIENCE_S: Final = 5.0
"""For a child to end in order; then it is killed."""


async def start_child(
    args: Sequence[str | Path], environment: Mapping[str, str], *, stderr: int | IO[bytes] = asyncio.subprocess.STDOUT
) -> Process:
    """Start a process whose stdout is read by the caller; raises OSError.

    Args:
        args: the program and its arguments.
        environment: see `child_environment`.
        stderr: where that goes; by default with stdout.
    """
    # Children end with us, also when we are killed.
    guard = ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []
    return await asyncio.create_subprocess_exec(
        *(*guard, *(str(arg) for arg in args)),
        env=dict(environment),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=stderr,
        start_new_session=True,
        limit=LONGEST_LINE_BYTES,
    )


async def end_child(process: Process) -> None:
    """End a process and what it has started; it has some seconds to do so in order."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        if process.returncode is not None:
            break
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_PATIENCE_S):
                await process.wait()


def how_it_ended(code: int) -> str:
    """An exit code for people."""
    return f"ended with code {code}" if code >= 0 else f"was ended by {signal.Signals(-code).name}"
