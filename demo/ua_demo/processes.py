"""The child processes of a demonstration: started with their output in log files, ended by their id."""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import signal
import socket
import time
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from ua_fleet.bridge.children import end_child, how_it_ended, start_child
from ua_fleet.errors import UaFleetError

__all__ = ["DemoFailed", "Processes", "free_loopback_address", "free_tcp_port", "udp_port_in_use"]

_LINES: Final = 1000
"""Lines of each process that are looked through for what is waited for; its log has all."""
_PORTS: Final = range(10_000, 20_000)
"""Below those that a system gives to connections (Linux: 32768 and above)."""


class DemoFailed(UaFleetError):
    """A part of the demonstration did not start or ended too early."""

    remedy = "Read the log that is named, in the folder of the demonstration."


class _Process:
    def __init__(self, name: str, process: asyncio.subprocess.Process, log: Path) -> None:
        self.name, self.process, self.log = name, process, log
        self.reader: asyncio.Task[None] | None = None
        self.lines: deque[str] = deque(maxlen=_LINES)
        self.changed = asyncio.Event()

    @property
    def code(self) -> int | None:
        """With what it ended, once all that it wrote has been read."""
        return self.process.returncode if self.reader is not None and self.reader.done() else None


class Processes:
    """Starts processes by name and ends all of them when the context is left."""

    def __init__(self, log_folder: Path) -> None:
        self._log_folder = log_folder
        self._processes: dict[str, _Process] = {}

    async def __aenter__(self) -> Self:
        self._log_folder.mkdir(parents=True, exist_ok=True)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await asyncio.gather(*(self._end(process) for process in reversed(self._processes.values())))

    async def start(
        self,
        name: str,
        args: Sequence[str | Path],
        environment: Mapping[str, str],
        on_line: Callable[[str], None] | None = None,
    ) -> None:
        """Start a process in a session of its own. `on_line` gets each line that it prints on stdout."""
        log = self._log_folder / f"{name}.log"
        errors = log.open("ab")
        try:
            started = await start_child(args, environment, stderr=errors)
        except OSError as problem:
            raise DemoFailed(f"{name} does not start: {problem}") from problem
        finally:
            errors.close()
        process = _Process(name, started, log)
        process.reader = asyncio.create_task(self._read(process, on_line), name=f"output of {name}")
        self._processes[name] = process

    async def _read(self, process: _Process, on_line: Callable[[str], None] | None) -> None:
        assert process.process.stdout is not None
        with process.log.open("a", encoding="utf-8") as log:
            async for raw in process.process.stdout:
                line = raw.decode(errors="replace").rstrip("\n")
                log.write(line + "\n")
                log.flush()
                process.lines.append(line)
                process.changed.set()
                if on_line is not None:
                    on_line(line)
        await process.process.wait()
        # The event comes after this task's end, which `code` waits for.
        asyncio.get_running_loop().call_soon(process.changed.set)

    async def kill(self, name: str) -> None:
        """Kill a process as a power cut would, and forget it, so that it can be started again."""
        process = self._processes.pop(name)
        process.process.kill()
        await process.process.wait()
        if process.reader is not None:
            await process.reader

    async def line_with(self, name: str, text: str, timeout_s: float) -> str:
        """The first of the last lines on stdout that contains `text`; raises DemoFailed when it does not come."""
        process = self._processes[name]
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while True:
                    process.changed.clear()
                    for line in process.lines:
                        if text in line:
                            return line
                    if process.code is not None:
                        break
                    await process.changed.wait()
        self.check()
        raise DemoFailed(f"{name} is not ready after {timeout_s:.0f} s; see {process.log}")

    async def listening(self, name: str, port: int, timeout_s: float) -> None:
        """Wait until a process listens on a TCP port of loopback; raises DemoFailed when it does not."""
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                _, writer = await asyncio.open_connection("127.0.0.1", port)
            except OSError:
                self.check()
            else:
                writer.close()
                with contextlib.suppress(OSError):
                    await writer.wait_closed()
                return
            if time.monotonic() > deadline:
                raise DemoFailed(f"{name} does not listen after {timeout_s:.0f} s; see {self._processes[name].log}")
            await asyncio.sleep(0.05)

    async def until(self, condition: Callable[[], bool], changed: asyncio.Event, timeout_s: float, what: str) -> None:
        """Wait until a condition holds; raises DemoFailed when it does not in time, or a process ends.

        Args:
            condition: looked at whenever `changed` is set, which it clears.
            changed: set by whoever takes in what the condition is about.
            timeout_s: longest wait.
            what: is waited for, for people.
        """
        deadline = time.monotonic() + timeout_s
        while not condition():
            changed.clear()
            self.check()
            left = deadline - time.monotonic()
            if left <= 0:
                raise DemoFailed(f"waited {timeout_s:.0f} s for {what}; see the logs in {self._log_folder}")
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(min(left, 0.5)):
                    await changed.wait()

    def check(self) -> None:
        """Raise DemoFailed if a process has ended, with the last line that it wrote."""
        for process in self._processes.values():
            if (code := process.code) is not None:
                said = _last_words(process.log.read_text(encoding="utf-8", errors="replace"))
                raise DemoFailed(f"{process.name} {how_it_ended(code)}{f': {said}' if said else ''}; see {process.log}")

    async def _end(self, process: _Process) -> None:
        await end_child(process.process)
        if process.reader is not None:
            await process.reader
        if process.code == -signal.SIGKILL:
            with process.log.open("a", encoding="utf-8") as log:
                log.write(f"{process.name} did not end when it was asked to, and was killed\n")


def _last_words(log: str) -> str:
    """The last line of a log; of one that is a JSON object its `event`."""
    last = log.strip().rpartition("\n")[2]
    if not last.startswith("{"):
        return last
    try:
        found: dict[str, object] = json.loads(last)
    except ValueError:
        return last
    return str(found.get("event", ""))


def _drawn() -> Generator[int]:
    yield from random.sample(_PORTS, len(_PORTS))


_others: Final = _drawn()
"""Each is given out once: who was given one may be about to listen there. All are drawn with the first one,
so that a process which was forked off has others."""


def free_tcp_port(preferred: int) -> int:
    """`preferred`, if it is not 0 and no process listens there on loopback, else a free port.

    Not one that the system may give to a connection before a process that has yet to start listens there.
    """
    if preferred and _is_free("127.0.0.1", preferred):
        return preferred
    for port in _others:
        if _is_free("127.0.0.1", port):
            return port
    raise DemoFailed(f"there is no free TCP port from {_PORTS[0]} to {_PORTS[-1]} on loopback")


def free_loopback_address(ports: Sequence[int], first: int = 2) -> str:
    """127.0.0.`first`, or another address of loopback, on which no process listens on any of these TCP ports.

    Args:
        ports: that a process is to listen on.
        first: 2 to 254; another one for each demonstration that may start in the same moment.

    Raises:
        DemoFailed: a process listens there on all addresses.
    """
    for number in (*range(first, 255), *range(2, first)):
        host = f"127.0.0.{number}"
        if all(_is_free(host, port) for port in ports):
            return host
    raise DemoFailed(f"one of the TCP ports {', '.join(map(str, ports))} is in use; end the program that listens there")


def _is_free(host: str, port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return False
    return True


def udp_port_in_use(port: int) -> bool:
    """Whether a process of this machine has bound a UDP port (IPv4)."""
    table = Path("/proc/net/udp").read_text(encoding="ascii").splitlines()[1:]
    return any(int(row.split()[1].rsplit(":", 1)[1], 16) == port for row in table)
