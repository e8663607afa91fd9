"""Processes of tests that need not import what they need: they are forked off one that has done so.

To import what a bridge needs takes 0.7 s of computing, more than most tests do with it.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import Final

__all__ = ["ForkedProcess"]

_lock: Final = threading.Lock()
_SERVER: Final = Path(__file__).with_name("fork_server.py")
_ROOT: Final = Path(__file__).resolve().parent.parent
_IMPORTED: Final = (
    "tests.integration.scenarios.machines",
    "ua_fleet.bridge.runner",
    "ua_fleet.cli.key_source",
    "ua_fleet.client",
    "ua_fleet.config.load",
    "ua_fleet.server.app",
    "ua_fleet.transport.udp",
)


class ForkedProcess:
    """A process, with what `subprocess.Popen` has for one."""

    def __init__(self, program: str | Path, arguments: Sequence[str], environment: Mapping[str, str]) -> None:
        output, printed = os.pipe()
        self._ended, told = socket.socketpair()
        request = {"program": str(program), "arguments": list(arguments), "environment": dict(environment)}
        with _lock:
            server = _server()
            socket.send_fds(server, [json.dumps(request).encode()], [printed, told.fileno()])
            self.pid: Final = int(server.recv(32))
        os.close(printed)
        told.close()
        self.returncode: int | None = None
        self.stdout: Final = TextIOWrapper(open(output, "rb"), errors="replace")  # noqa: SIM115 - its reader closes it

    def poll(self) -> int | None:
        """How it ended; None while it runs."""
        return self._look(0)

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; how it was. Raises subprocess.TimeoutExpired."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while (code := self._look(None if deadline is None else max(0.0, deadline - time.monotonic()))) is None:
            if deadline is not None and time.monotonic() >= deadline:
                raise subprocess.TimeoutExpired([str(self.pid)], timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        """Send it a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Send it SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send it SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def _look(self, timeout_s: float | None) -> int | None:
        if self.returncode is None and select.select([self._ended], [], [], timeout_s)[0]:
            said = self._ended.recv(32)
            self._ended.close()
            self.returncode = int(said) if said else -signal.SIGKILL  # what starts processes is gone itself
        return self.returncode


@functools.cache
def _server() -> socket.socket:
    """The process that has imported everything, one for each process of tests."""
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    environment = {
        name: value
        for name, value in os.environ.items()
        if name not in ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
    }
    path = os.pathsep.join((str(_ROOT), str(_ROOT / "bridges")))
    server = subprocess.Popen(
        [sys.executable, "-u", _SERVER, *_IMPORTED],
        stdin=its.fileno(),
        stdout=subprocess.DEVNULL,
        env=environment | {"PYTHONPATH": path},
    )
    its.close()

    def end() -> None:
        with contextlib.suppress(OSError):
            ours.close()
        server.wait(10)

    atexit.register(end)
    return ours
