"""Processes of tests that need not import what they need: they are forked off one that has done so.

To import what a bridge needs takes 0.7 s of computing, more than most tests do with it; what a server needs, and the
nodes that the standard gives it, two seconds.
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
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from io import TextIOWrapper
from pathlib import Path
from typing import Final, NamedTuple

__all__ = ["Command", "ForkServer", "ForkedProcess", "command_of", "computed_s"]

_lock: Final = threading.Lock()
_computed_s: Final[list[float]] = []
_SERVER: Final = Path(__file__).with_name("fork_server.py")
_ROOT: Final = Path(__file__).resolve().parent.parent
_COMMANDS: Final = {
    str(Path(python).with_name("ua-fleet")): python
    for python in (sys.executable, str(_ROOT / ".venv-ros1" / "bin" / "python"))
}
"""The command of each Python that has it, ours and the one with rospy."""
_IMPORTED: Final = (
    "ament_index_python",
    "anyio._backends._asyncio",
    "cryptography.hazmat.backends.openssl.backend",
    "em",
    "encodings.idna",
    "geometry_msgs.msg",
    "lark",
    "nav_msgs.msg",
    "numpy",
    "pkgutil",
    "rcl_interfaces.msg",
    "rcl_interfaces.srv",
    "rosgraph_msgs.msg",
    "rosidl_generator_py",
    "rospy",
    "sensor_msgs.msg",
    "std_msgs.msg",
    "std_srvs.srv",
    "tests.integration.scenarios.machines",
    "type_description_interfaces.srv",
    "typer._adapters",
    "ua_bridges.modbus.config",
    "ua_bridges.modbus.driver",
    "ua_bridges.plugged.config",
    "ua_bridges.plugged.driver",
    "ua_bridges.ros1.config",
    "ua_bridges.ros1.driver",
    "ua_bridges.ros1.session",
    "ua_bridges.ros1.skills",
    "ua_bridges.ros2.config",
    "ua_bridges.ros2.driver",
    "ua_bridges.ros2.session",
    "ua_bridges.ros2.skills.driver",
    "ua_bridges.tcp.config",
    "ua_bridges.tcp.driver",
    "ua_bridges.ur.config",
    "ua_bridges.ur.driver",
    "ua_demo.commands.pal",
    "ua_demo.commands.simulate",
    "ua_demo.commands.talkrobots",
    "ua_demo.pal.run",
    "ua_demo.ros_node",
    "ua_demo.simulators.tcp",
    "ua_demo.talkrobots.run",
    "ua_fleet.bridge.children",
    "ua_fleet.bridge.launch",
    "ua_fleet.bridge.runner",
    "ua_fleet.carrier",
    "ua_fleet.cli.app",
    "ua_fleet.cli.key_source",
    "ua_fleet.client",
    "ua_fleet.config.load",
    "ua_fleet.console.load",
    "ua_fleet.console.run",
    "ua_fleet.relay",
    "ua_fleet.server.app",
    "ua_fleet.server.mutual_trust",
    "ua_fleet.storage.postgres_history",
    "ua_fleet.transport.mqtt.transport",
    "ua_fleet.transport.udp",
    "uvicorn.lifespan.off",
    "wait_for2",
)
"""What programs load when they start or later; what an interpreter has not is left out.

rclpy is not among them: it starts threads, which no fork has. Its messages are, which are as much to load.
"""


class Command(NamedTuple):
    """A program in Python."""

    python: str
    program: str
    """A file's path or a module's name."""
    is_module: bool
    arguments: list[str]


class ForkedProcess:
    """A process, with what `subprocess.Popen` has for one."""

    def __init__(
        self,
        command: Command,
        environment: Mapping[str, str],
        *,
        reads: bool = False,
        complains: bool = False,
        folder: Path | None = None,
        server: ForkServer | None = None,
    ) -> None:
        """Fork it.

        Args:
            command: see `command_of`.
            environment: all of its variables.
            reads: what is written to `stdin`; else nothing.
            complains: to `stderr`; else to `stdout`, with all that it says.
            folder: where it works; else where this process does.
            server: what it is forked off; it stays in this one's group, with its stderr. Else one that has the product.
        """
        output, printed = os.pipe()
        self.stdin: TextIOWrapper | None = None
        self.stderr: TextIOWrapper | None = None
        if reads:
            given, written = os.pipe()
            self.stdin = TextIOWrapper(open(written, "wb"))  # noqa: SIM115 - who writes closes it
        else:
            given = os.open(os.devnull, os.O_RDONLY)
        if complains:
            complaints, complained = os.pipe()
            self.stderr = TextIOWrapper(open(complaints, "rb"), errors="replace")  # noqa: SIM115 - as stdout
        else:
            complained = os.dup(printed if server is None else 2)
        self._ended, told = socket.socketpair()
        request = {
            "program": command.program,
            "is_module": command.is_module,
            "arguments": command.arguments,
            "environment": dict(environment),
            "folder": str(folder or Path.cwd()),
            "has_session": None if server is None else False,
        }
        self.returncode: int | None = None
        self.stdout: Final = TextIOWrapper(open(output, "rb"), errors="replace")  # noqa: SIM115 - its reader closes it
        try:
            with _lock:
                server = server or _server(command.python)
                self.pid: Final = server.fork(request, [given, printed, complained, told.fileno()])
        except RuntimeError:
            for held in (self.stdin, self.stdout, self.stderr, self._ended):
                if held is not None:
                    held.close()
            raise
        finally:
            for descriptor in (given, printed, complained):
                os.close(descriptor)
            told.close()

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

    def communicate(self, given: str, timeout: float) -> tuple[str, str]:
        """Write to its stdin and wait for its end: what it said, and what it complained of.

        Raises subprocess.TimeoutExpired, and has killed it then.
        """
        assert self.stdin is not None, "it reads nothing"
        assert self.stderr is not None, "it complains to stdout"
        with ThreadPoolExecutor(2) as readers, self.stdout, self.stderr:
            said, complained = (readers.submit(stream.read) for stream in (self.stdout, self.stderr))
            with contextlib.suppress(BrokenPipeError), self.stdin:
                self.stdin.write(given)
            try:
                self.wait(timeout)
            except subprocess.TimeoutExpired:
                self.kill()
                raise
            return said.result(), complained.result()

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
            said = self._ended.recv(64).split()
            self._ended.close()
            self.returncode = int(said[0]) if said else -signal.SIGKILL  # what starts processes is gone itself
            if said:
                _computed_s.append(float(said[1]))
        return self.returncode


def command_of(words: Sequence[str | Path]) -> Command | None:
    """The file or the module that a command has a Python run, ours or the one with rospy; None for any other command.

    `ua-fleet` of one of them is its module `ua_fleet.cli`.

    Output is never held back in a forked process: so `-u` is as nothing.
    """
    python, *rest = [str(word) for word in words]
    if python in _COMMANDS:
        return Command(_COMMANDS[python], "ua_fleet.cli", True, rest)
    if python not in _COMMANDS.values():
        return None
    if rest[:1] == ["-u"]:
        del rest[0]
    if rest[:1] == ["-m"]:
        return Command(python, rest[1], True, rest[2:])
    return Command(python, rest[0], False, rest[1:]) if rest[0].endswith(".py") else None


def computed_s() -> float:
    """Seconds that processes have computed which were forked off and of whose ends this process knows."""
    return sum(_computed_s)


class ForkServer:
    """The process that has imported everything."""

    def __init__(self, python: str, *arguments: str) -> None:
        """Start it with arguments of `fork_server`."""
        self._ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        environment = {
            name: value
            for name, value in os.environ.items()
            if name not in ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
        }
        path = os.pathsep.join((str(_ROOT), str(_ROOT / "bridges"), str(_ROOT / "demo")))
        self._complaints = tempfile.TemporaryFile()  # noqa: SIM115 - read at its end
        with its:
            self._process = subprocess.Popen(
                [python, "-u", _SERVER, *arguments],
                stdin=its.fileno(),
                stdout=subprocess.DEVNULL,
                stderr=self._complaints,
                env=environment | {"PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"},  # numpy's threads are not forked
            )

    def fork(self, request: Mapping[str, object], descriptors: Sequence[int]) -> int:
        """The id of a process that is forked off. Raises RuntimeError, with what was complained of, if it cannot be."""
        answer = b""
        with contextlib.suppress(OSError):  # it has ended
            socket.send_fds(self._ours, [json.dumps(request).encode()], descriptors)
            answer = self._ours.recv(32)
        if answer:
            return int(answer)
        code = self.end()
        _server.cache_clear()  # one failed test is enough
        self._complaints.seek(0)
        complaints = self._complaints.read().decode(errors="replace")[-4_000:]
        raise RuntimeError(f"the process that forks others ended with {code}: {complaints}")

    def end(self) -> int:
        """How it ended."""
        self._ours.close()
        return self._process.wait(10)


@functools.cache
def _server(python: str) -> ForkServer:
    """One of each Python for each process of tests."""
    server = ForkServer(python, *_IMPORTED)
    atexit.register(server.end)
    return server
