"""The serial port of a device: opened, kept, and opened again. All of it runs in the event loop, and nothing waits.

The port is opened when its device is plugged in, since many devices start anew at that, and stays open; it is read only
while something on it is needed.
"""

# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import errno
import grp
import logging
import os
import select
import stat
import termios
import time
from collections.abc import Callable
from typing import Any, Final

import serial

from ua_bridges.plugged.config import SerialSettings
from ua_bridges.plugged.lines import Lines, NewestKey

__all__ = ["Port"]

RETRY_S: Final = 1.0
_READ_BYTES: Final = 4096
MOST_UNSENT: Final = 1 << 16
"""Bytes of commands that a device may leave unread."""
_PARITY: Final = {"none": "N", "even": "E", "odd": "O"}

logger = logging.getLogger(__name__)


class Port:
    """One serial port; `lines` says what is said on it."""

    def __init__(self, device: str, settings: SerialSettings, turned: Callable[[], None]) -> None:
        """`turned` is called when something was heard, or the port was opened or closed."""
        self._device, self._settings, self._turned = device, settings, turned
        self._lines: Lines | None = None
        self._node: str | None = None
        self._serial: Any = None
        self._opening: asyncio.Future[Any] | None = None
        self._retry: asyncio.TimerHandle | None = None
        self._unsent = bytearray()
        """Commands in their order, behind the rest of a line that has gone out in part."""
        self._newest: dict[NewestKey, bytes] = {}
        """Lines that wait until the kernel has little left to send, since a command must not wait behind them."""
        self._listens = False
        self._said = ""
        self.detail = ""
        """Where it is, or why it is not open and what to do."""

    def attach(self, lines: Lines) -> None:
        """Say what is said on it; before `plugged`."""
        self._lines = lines

    def plugged(self, node: str) -> None:
        """The device is there, as this file."""
        self._loop = asyncio.get_running_loop()
        self._node = node
        self._open()

    def unplugged(self, why: str) -> None:
        """The device is gone."""
        self._node = None
        self._close(why)
        if self._retry is not None:
            self._retry.cancel()
            self._retry = None
        self.detail = ""

    async def stop(self) -> None:
        """Leave the port, also where it is just being opened. Safe to call twice."""
        self.unplugged("stopped")
        if self._opening is not None:
            await asyncio.wait([self._opening])

    # Opening

    def _open(self) -> None:
        self._retry = None
        if self._node is None or self._serial is not None or self._opening is not None:
            return
        self._opening = opening = self._loop.run_in_executor(None, self._opened_port, self._node)
        opening.add_done_callback(self._opened)

    def _opened_port(self, node: str) -> Any:
        settings = self._settings
        return serial.Serial(
            node,
            settings.baud,
            parity=_PARITY[settings.parity],
            stopbits=settings.stop_bits,
            timeout=0,
            write_timeout=0,
            exclusive=True,
        )

    def _opened(self, opening: asyncio.Future[Any]) -> None:
        self._opening = None
        if opening.cancelled():
            return
        error = opening.exception()
        if error is not None:
            if self._node is not None:
                self._say(f"{self._node} cannot be opened: {self._reason(error)}")
                self._again()
            return
        port = opening.result()
        if self._node is None or port.port != self._node:
            port.close()
            self._open()
            return
        self._serial = port
        self._say(f"plugged in at {self._node}")
        assert self._lines is not None
        self._lines.opened(time.monotonic(), time.time_ns())
        self._turned()

    def _again(self) -> None:
        if self._retry is None and self._node is not None:
            self._retry = self._loop.call_later(RETRY_S, self._open)

    def _reason(self, error: BaseException) -> str:
        code, node = getattr(error, "errno", None), self._node or ""
        text = str(error)
        if code in (errno.EACCES, errno.EPERM):
            return f"permission denied; put the bridge's user into the group {_group_of(node)} and log in again"
        if code == errno.EBUSY or "exclusively lock" in text:
            return "another program uses it; end that one"
        if code in (errno.ENOTTY, errno.EINVAL) or "configure port" in text:
            return "it is no serial port, or cannot be set like this; see the device's `match` and `port`"
        return (os.strerror(code) if isinstance(code, int) else text) + "; it is tried again"

    def _close(self, why: str) -> None:
        port, self._serial = self._serial, None
        if port is None:
            return
        self._loop.remove_reader(port.fd)
        self._loop.remove_writer(port.fd)
        self._unsent.clear()
        never_sent, self._newest = list(self._newest), {}
        self._listens = False
        try:
            port.close()
        except (OSError, termios.error):
            logger.debug("%s: the port was gone before it was closed", self._device)
        self._say(why)
        assert self._lines is not None
        for key in never_sent:
            self._lines.never_sent(key)
        self._lines.closed(why, time.monotonic())
        self._turned()

    def reset(self, why: str) -> None:
        """Close and open the port, since nothing sensible can follow on it."""
        self._loop.call_soon(self._fail, self._serial, why)

    def _fail(self, port: Any, why: str) -> None:
        if port is not None and self._serial is port:
            self._close(f"{self._device}: {why}")
            self._again()

    def _say(self, detail: str) -> None:
        self.detail = detail
        if detail != self._said:
            self._said = detail
            logger.debug("device %s: %s", self._device, detail)  # the bridge says what it comes to

    # Bytes

    def listen(self) -> None:
        """Read from now on where something is needed, and no more where nothing is."""
        port, lines = self._serial, self._lines
        if port is None or lines is None or lines.listens == self._listens:
            return
        self._listens = lines.listens
        if not self._listens:
            self._loop.remove_reader(port.fd)
            return
        try:
            port.reset_input_buffer()
        except (OSError, termios.error) as error:
            self.reset(f"it is gone ({error})")
            return
        lines.begin_listening()
        self._loop.add_reader(port.fd, self._readable)

    def _readable(self) -> None:
        port = self._serial
        try:
            data = os.read(port.fd, _READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._fail(port, f"it was pulled out, or failed ({error.strerror})")
            return
        if not data:
            self._fail(port, "it was pulled out, or its other end closed it")
            return
        assert self._lines is not None
        self._lines.received(data, time.monotonic(), time.time_ns())
        self._turned()

    def write(self, data: bytes) -> bool:
        """Send a command, at once where the kernel takes it; False where the port is over: then none has gone out."""
        port = self._serial
        if port is None:
            return False
        if self._unsent:
            if len(self._unsent) + len(data) > MOST_UNSENT:
                self.reset("it does not read what it is sent")
                return False
            self._unsent += data
            return True
        try:
            sent = os.write(port.fd, data)
        except (BlockingIOError, InterruptedError):
            sent = 0
        except OSError as error:
            self.reset(f"it was pulled out, or failed ({error.strerror})")
            return False
        if sent < len(data):
            self._unsent += data[sent:]
            self._loop.add_writer(port.fd, self._writable)
        return True

    def write_newest(self, key: NewestKey, data: bytes) -> bool:
        """Send a line once nothing else waits, or a newer one with its key instead; False where the port is over."""
        port = self._serial
        if port is None:
            return False
        if not self._unsent and not self._newest and _is_free(port.fd):
            return self.write(data)
        if key in self._newest:
            assert self._lines is not None
            self._lines.overtaken(key)
        self._newest[key] = data  # in the place of the older one, so that none waits for ever
        self._loop.add_writer(port.fd, self._writable)
        return True

    def _writable(self) -> None:
        port = self._serial
        newest = None if self._unsent else next(iter(self._newest))
        line = self._unsent if newest is None else self._newest[newest]
        try:
            sent = os.write(port.fd, line)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._fail(port, f"it was pulled out, or failed ({error.strerror})")
            return
        if newest is None:
            del self._unsent[:sent]
        else:
            self._unsent += self._newest.pop(newest)[sent:]
        if not self._unsent and not self._newest:
            self._loop.remove_writer(port.fd)


def _is_free(descriptor: int) -> bool:
    """Whether a serial port has less than 256 bytes left to send, which is when Linux says that it is writable.

    Its buffer takes 4 KiB, for which a line of 9600 baud needs 4 s. True as well where the port is over.
    """
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    return bool(poll.poll(0))


def _group_of(node: str) -> str:
    """The group that may use a device; `dialout` where that cannot be seen."""
    try:
        status = os.stat(node)
        if status.st_gid and status.st_mode & stat.S_IWGRP:
            return grp.getgrgid(status.st_gid).gr_name
    except (OSError, KeyError):
        pass
    return "dialout"
