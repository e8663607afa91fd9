"""A device on a serial port for tests: the real terminal of a pty, and a thread that is its firmware."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import select
import struct
import termios
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

__all__ = ["PtyDevice"]

Firmware = Callable[["PtyDevice", str], None]
"""Told of each line that the device gets."""


class PtyDevice:
    """What stands at `path` while it is plugged in."""

    def __init__(self, path: Path, firmware: Firmware) -> None:
        self.path, self._firmware = path, firmware
        self.heard: list[str] = []
        self._lock = threading.Lock()
        self._master: int | None = None
        self._slave: int | None = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        self.plug()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.unplug()

    def plug(self) -> None:
        """Be there."""
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._end, self._ended = os.pipe()
        target, link = os.ttyname(self._slave), self.path.with_name(f".{self.path.name}")
        with contextlib.suppress(FileNotFoundError):
            link.unlink()
        self._thread = threading.Thread(target=self._run, args=(self._master,), name="device", daemon=True)
        self._thread.start()
        link.symlink_to(target)
        link.rename(self.path)

    def unplug(self) -> None:
        """Be gone."""
        with self._lock:
            master, slave, self._master, self._slave = self._master, self._slave, None, None
        if master is None or slave is None:
            return
        self.path.unlink(missing_ok=True)
        os.close(self._ended)
        assert self._thread is not None
        self._thread.join(5)
        for end in (self._end, slave, master):
            os.close(end)

    def say(self, text: str) -> None:
        """Say something, with its end of line. What nobody takes is lost, as on a real line."""
        self.write(text.encode())

    def write(self, content: bytes) -> None:
        """Say any bytes."""
        with self._lock:
            if self._master is not None:
                with contextlib.suppress(BlockingIOError):
                    os.write(self._master, content)

    def wait_for_reader(self, timeout_s: float = 60.0) -> None:
        """Wait until somebody reads what it says. Empty lines may be thrown away when the port is opened, when it is
        listened to, and as the end of half a line."""
        deadline = time.monotonic() + timeout_s
        for _ in range(3):
            self.say("\n")
            while self._unread() and time.monotonic() < deadline:
                time.sleep(0.001)

    def _unread(self) -> int:
        with self._lock:
            if self._slave is None:
                return 0
            select.select([self._slave], [], [], 0)  # the kernel hands over now what it otherwise would a little later
            return int(struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, b"\0" * 4))[0])

    def _run(self, master: int) -> None:
        left = b""
        while True:
            ready, _, _ = select.select([master, self._end], [], [])
            if self._end in ready:
                return
            try:
                *lines, left = (left + os.read(master, 4096)).split(b"\n")
            except BlockingIOError:
                continue
            for line in lines:
                self.heard.append(line.decode())
                self._firmware(self, line.decode())
