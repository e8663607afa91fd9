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
import secrets
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

__all__ = ["Command", "ForkServer", "ForkedProcess", "SharedForkServer", "command_of", "computed_s", "share"]

_lock: Final = threading.Lock()
_computed_s: Final[list[float]] = []
_SERVER: Final = Path(__file__).with_name("fork_server.py")
_ROOT: Final = Path(__file__).resolve().parent.parent
_ROS1_PYTHON: Final = str(_ROOT / ".venv-ros1" / "bin" / "python")
_COMMANDS: Final = {str(Path(python).with_name("ua-fleet")): python for python in (sys.executable, _ROS1_PYTHON)}
"""The command of each Python that has it, ours and the one with rospy."""
_MASTERS: Final = ("/usr/bin/rosmaster", "rosmaster")
_ENV: Final = "/usr/bin/env"
_RUN: Final = os.environ.setdefault("UA_TESTS_ARE_FORKED_BY", secrets.token_hex(8))
"""By this word in their environment all processes of a run find those that fork others."""
_IMPORTED: Final = (
    "actionlib",
    "ament_index_python",
    "anyio._backends._asyncio",
    "configparser",
    "cryptography.hazmat.backends.openssl.backend",
    "em",
    "encodings.idna",
    "geometry_msgs.msg",
    "lark",
    "move_base_msgs.msg",
    "nav_msgs.msg",
    "numpy",
    "pkgutil",
    "pymodbus.server",
    "rcl_interfaces.msg",
    "rcl_interfaces.srv",
    "rclpy.action",
    "rclpy.event_handler",
    "rclpy.executors",
    "rclpy.experimental.events_executor",
    "rclpy.node",
    "rclpy.serialization",
    "rosgraph_msgs.msg",
    "rosidl_generator_py",
    "rosgraph.roslogging",
    "rosmaster.main",
    "rospy",
    "sensor_msgs.msg",
    "std_msgs.msg",
    "std_srvs.srv",
    "tests.integration.scenarios.machines",
    "tests.ros2_spinning",
    "tests.saying",
    "type_description_interfaces.msg",
    "type_description_interfaces.srv",
    "typer._adapters",
    "ua_bridges.modbus.config",
    "ua_bridges.modbus.driver",
    "ua_bridges.plugged.config",
    "ua_bridges.plugged.driver",
    "ua_bridges.robot.ros1",
    "ua_bridges.robot.ros2",
    "ua_bridges.ros1.config",
    "ua_bridges.ros1.driver",
    "ua_bridges.ros1.session",
    "ua_bridges.ros1.skills.driver",
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
    "ua_demo.hand",
    "ua_demo.pal.run",
    "ua_demo.ros_node",
    "ua_demo.simulators.modbus.server",
    "ua_demo.simulators.tcp",
    "ua_demo.simulators.ur.server",
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
"""What programs load when they start or later; what an interpreter has not is left out."""


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
        terminal: int | None = None,
    ) -> None:
        """Fork it.

        Args:
            command: see `command_of`.
            environment: all of its variables.
            reads: what is written to `stdin`; else nothing.
            complains: to `stderr`; else to `stdout`, with all that it says.
            folder: where it works; else where this process does.
            server: what it is forked off; it stays in this one's group, with its stderr. Else one that has the product.
            terminal: what it reads, and where it says everything; nothing comes to `stdout` then.
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
        if terminal is not None:
            os.dup2(terminal, given)
            os.dup2(terminal, printed)
            os.dup2(terminal, complained)
        self._ended, told = socket.socketpair()
        request = {
            "program": command.program,
            "is_module": command.is_module,
            "arguments": command.arguments,
            "environment": dict(environment),
            "folder": str(folder or Path.cwd()),
            # On a terminal in a session of its own, since it is asked there and nowhere else.
            "has_session": True if terminal is not None else None if server is None else False,
        }
        self.returncode: int | None = None
        self.stdout: Final = TextIOWrapper(open(output, "rb"), errors="replace")  # noqa: SIM115 - its reader closes it
        try:
            with _lock:
                forks = server or _server(command.python)
                self.pid: Final = forks.fork(request, [given, printed, complained, told.fileno()])
        except RuntimeError:
            _server.cache_clear()  # one failed test is enough
            for held in (self.stdin, self.stdout, self.stderr, self._ended):
                if held is not None:
                    held.close()
            raise
        finally:
            for descriptor in (given, printed, complained):
                os.close(descriptor)
            told.close()
        if terminal is not None:
            self.stdout.close()

    def close(self) -> None:
        """Close what is written to it and read of it."""
        for held in (self.stdin, self.stdout, self.stderr):
            if held is not None:
                held.close()

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
            self.returncode, seconds = how_it_was(self._ended)
            _computed_s.append(seconds)
        return self.returncode


def how_it_was(ended: socket.socket) -> tuple[int, float]:
    """How a forked process ended that tells of it now, and the seconds that it and its children have computed."""
    with ended, ended.makefile() as told:
        *others, last = [line.split() for line in told] or [[str(-signal.SIGKILL), "0"]]  # by who forks and is gone
    return int(last[0]), sum(float(seconds) for _, seconds in (*others, last))


def command_of(words: Sequence[str | Path]) -> Command | None:
    """The file or the module that a command has a Python run, ours or the one with rospy; None for any other command.

    `ua-fleet` of one of them is its module `ua_fleet.cli`, and the ROS master is a program of the one with rospy.

    Output is never held back in a forked process: so `-u` is as nothing.
    """
    python, *rest = [str(word) for word in words if str(word) != _ENV]
    if python in _MASTERS and Path(_ROS1_PYTHON).exists():
        return Command(_ROS1_PYTHON, _MASTERS[0], False, rest)
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

    def __init__(self, python: str, *arguments: str, listener: socket.socket | None = None) -> None:
        """Start it with arguments of `fork_server`, for others too that connect to a listener."""
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
                pass_fds=() if listener is None else (listener.fileno(),),
            )

    def fork(self, request: Mapping[str, object], descriptors: Sequence[int]) -> int:
        """The id of a process that is forked off. Raises RuntimeError, with what was complained of, if it cannot be."""
        if answer := _asked(self._ours, request, descriptors):
            return int(answer)
        raise RuntimeError(f"the process that forks others ended with {self.end()}: {self.complaints}")

    @property
    def complaints(self) -> str:
        """Of it that has ended, and of those that were forked off it."""
        self._complaints.seek(0)
        return self._complaints.read().decode(errors="replace")[-4_000:]

    def end(self) -> int:
        """How it ended."""
        self._ours.close()
        return self._process.wait(10)

    def close(self) -> None:
        """End it, when nobody asks any more what it has complained of."""
        self.end()
        self._complaints.close()


class SharedForkServer:
    """One that this or another process of the run has started (`share`)."""

    def __init__(self, python: str) -> None:
        """Raises ConnectionRefusedError where there is none."""
        self._ours = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        atexit.register(self._ours.close)
        self._ours.connect(_address_for(python))

    def fork(self, request: Mapping[str, object], descriptors: Sequence[int]) -> int:
        """See ForkServer."""
        if answer := _asked(self._ours, request, descriptors):
            return int(answer)
        said = "".join(server.complaints for server in _started)
        raise RuntimeError(f"the process that forks others has ended: {said}")


def _asked(server: socket.socket, request: Mapping[str, object], descriptors: Sequence[int]) -> bytes:
    """What it answers; nothing if it has ended."""
    with contextlib.suppress(OSError):
        socket.send_fds(server, [json.dumps(request).encode()], descriptors)
        return server.recv(32)
    return b""


def _address_for(python: str) -> str:
    """Where what forks processes of this Python listens; there is one in a run."""
    return f"\0ua-fleet-tests-{_RUN}-{Path(python).parent.parent.name}"


_started: Final[list[ForkServer]] = []
"""By this process, each of which ends with it."""


def share() -> None:
    """Start one for each Python, for all processes that this one starts, too; it imports once something is forked."""
    for python in dict.fromkeys(_COMMANDS.values()):
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
            try:
                listener.bind(_address_for(python))
            except OSError:  # another process of this run has started one
                continue
            listener.listen()
            if Path(python).exists():
                _started.append(ForkServer(python, str(listener.fileno()), *_IMPORTED, listener=listener))
                atexit.register(_started[-1].close)


@functools.cache
def _server(python: str) -> SharedForkServer:
    """One of each Python for all processes of tests, or for this one where it was started alone."""
    with contextlib.suppress(ConnectionRefusedError):
        return SharedForkServer(python)
    share()
    return SharedForkServer(python)
