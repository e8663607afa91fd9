"""Starts programs of tests as processes that have imported already what they need: `fork_server.py NUMBER MODULE...`.

Or, for the processes that run tests (`forked_workers`), the files of these: `fork_server.py --collect FILE...`.

The socket on file descriptor 0 brings requests: what is run, its arguments, environment and folder as JSON, and with
them four file descriptors: what the process reads, where it prints, where it complains, and where is told how it ends.
Each is answered with the process id. What runs is the program, in a process and a group of its own; only its imports
were done before, and the nodes that the standard gives an OPC UA server. An ended process is there until nobody holds
the other end of the last descriptor, so that no other one has its id. Ends when the socket is closed.

The NUMBER is of a descriptor at which others connect who have requests. Nothing is imported before the first.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import faulthandler
import functools
import gc
import importlib
import json
import os
import runpy
import select
import signal
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from tests import forked_children

REQUEST_BYTES = 1 << 17
COLLECT = "--collect"
THREADS_OF_ROS = 2
"""LTTng, which the C of ROS 2 is built with, has them wait for who asks for traces; who is forked off does without."""
PEER = struct.Struct("3i")
"""Process, user and group of who has connected."""
OF_LAUNCHERS = (["demo"], ["up"], ["--runs"])
"""The first argument of what starts many programs in Python: demonstrations, fleets, and `tests.carried.killed`."""


def is_launcher(request: dict[str, Any]) -> bool:
    """Whether children of what was asked for are forked, too."""
    return request["is_module"] and request["arguments"][:1] in OF_LAUNCHERS


def become(request: dict[str, Any], descriptors: list[int], left: int | None = None) -> None:
    """Be a process of its own, as one that was started with this environment and these arguments.

    It has the descriptors as 0, 1 and 2, and no others, but one that is `left` as it is.
    """
    has_session = request.get("has_session")
    if has_session:
        os.setsid()
    elif has_session is None:  # of a child that a program has started, which stays in its group
        os.setpgid(0, 0)
    kept = [os.dup(descriptor) for descriptor in descriptors]  # above those that they become
    for source, target in zip(kept, range(3), strict=True):
        os.dup2(source, target)
    os.closerange(3, left or 1 << 16)
    os.closerange((left or 3) + 1, 1 << 16)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    time.tzset()
    program = request["program"]
    sys.argv[:] = [program, *request["arguments"]]  # the same list, which what was imported may have kept
    show([sys.executable, *(["-m"] if request["is_module"] else []), *sys.argv])
    sys.path[0] = request["folder"] if request["is_module"] else os.path.dirname(os.path.abspath(program))
    faulthandler.enable()  # one that has to be killed says by SIGABRT where it stands
    sys.path[1:1] = [place for place in os.environ.get("PYTHONPATH", "").split(os.pathsep) if place]
    gc.enable()


def show(words: list[str]) -> None:
    """Have the list of processes show these words, in the place of those that this one was started with."""
    with open("/proc/self/stat", encoding="ascii", errors="replace") as stat:
        start, end = map(int, stat.read().rpartition(")")[2].split()[45:47])
    shown = b"\0".join(os.fsencode(word) for word in words)[: end - start - 1]
    ctypes.memmove(start, shown.ljust(end - start, b"\0"), end - start)


def computed_s(pid: int) -> float:
    """Seconds that a process has computed that has ended and is not waited for yet, with its children."""
    with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as stat:
        fields = stat.read().rpartition(")")[2].split()
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


class Server:
    """Starts processes for its owner, and for others who connect to its listener, if it has one."""

    def __init__(self, owner: socket.socket, listener: socket.socket | None, prepare: Callable[[], None]) -> None:
        """`prepare` is called before the first process is started."""
        self._owner, self._listener, self._prepare = owner, listener, prepare
        self._is_prepared = False
        self._channels = {owner.fileno(): owner}
        self._running: dict[int, tuple[int, int]] = {}
        """Process ids by the descriptors that tell of their ends, each with where to write how it was."""
        self._ended: dict[int, int] = {}
        """Process ids by the descriptors where that was written."""
        self._with_parent: dict[int, int] = {}
        """Of those that run and have to end with who had them started, by where that is to be told of their ends."""
        self._looked_at = select.poll()
        for one in (owner, listener):
            if one is not None:
                self._looked_at.register(one, select.POLLIN)

    def serve(self) -> dict[str, Any] | None:
        """Start processes until the owner's socket is closed; in such a process, what was asked for."""
        while True:
            for found, _ in self._looked_at.poll():
                if found in self._running:
                    self._tell(found)
                elif found in self._with_parent:
                    os.kill(self._with_parent.pop(found), signal.SIGTERM)
                    self._looked_at.unregister(found)
                    continue
                elif found in self._ended:
                    os.waitpid(self._ended.pop(found), 0)
                elif self._listener is not None and found == self._listener.fileno():
                    self._accept(self._listener)
                    continue
                else:
                    channel = self._channels[found]
                    data, descriptors, _, _ = socket.recv_fds(channel, REQUEST_BYTES, 4)
                    if data:
                        request: dict[str, Any] = json.loads(data)
                        if self._start(channel, request, descriptors):
                            return request
                        continue
                    if channel is self._owner:
                        return None
                    self._channels.pop(found).detach()
                self._looked_at.unregister(found)
                os.close(found)

    def _tell(self, found: int) -> None:
        pid, told = self._running.pop(found)
        self._with_parent.pop(told, None)
        how = os.waitid(os.P_PIDFD, found, os.WEXITED | os.WNOWAIT)
        assert how is not None
        code = how.si_status if how.si_code == os.CLD_EXITED else -how.si_status
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(told)) as telling:  # nobody may listen any more
            telling.send(f"{code} {computed_s(pid):.2f}\n".encode())
            telling.shutdown(socket.SHUT_WR)
        self._ended[told] = pid
        self._looked_at.register(told, select.POLLIN)

    def _accept(self, listener: socket.socket) -> None:
        channel, _ = listener.accept()
        of_peer = channel.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, PEER.size)
        if PEER.unpack(of_peer)[1] != os.getuid():  # another user has nothing started here
            channel.close()
            return
        self._channels[channel.fileno()] = channel
        self._looked_at.register(channel, select.POLLIN)

    def _start(self, channel: socket.socket, request: dict[str, Any], descriptors: list[int]) -> bool:
        """Whether this is the process that was started."""
        if not self._is_prepared:
            self._prepare()
            await_one_thread()
            gc.collect()
            gc.freeze()
            self._is_prepared = True
        *streams, told = descriptors
        pid = os.fork()
        if pid == 0:
            for held in (*self._channels.values(), *((self._listener,) if self._listener is not None else ())):
                held.detach()  # closed with all the others
            request["told"] = told if is_launcher(request) else None
            become(request, streams, request["told"])
            return True
        if request.get("has_session") is None:
            with contextlib.suppress(OSError):  # it has done so itself, or is gone
                os.setpgid(pid, pid)
        for stream in streams:
            os.close(stream)
        ends = os.pidfd_open(pid)
        self._running[ends] = pid, told
        self._looked_at.register(ends, select.POLLIN)
        if request.get("ends_with_parent"):
            self._with_parent[told] = pid
            self._looked_at.register(told, select.POLLIN)
        with contextlib.suppress(BrokenPipeError):  # who asked has ended
            channel.send(str(pid).encode())
        return False


def prepare(modules: list[str]) -> None:
    """Do what all processes would do alike."""
    importlib.import_module("tests.known_keys").keep()
    for module in modules:
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    importlib.import_module("tests.command_tree").keep()
    if (command_line := sys.modules.get("ua_fleet.cli.app")) is not None:
        importlib.import_module("typer.main").get_command(command_line.app)
    if "rosgraph.xmlrpc" in sys.modules:
        importlib.import_module("tests.rospy_ends").keep()
    if "ua_fleet.server.app" in sys.modules:
        importlib.import_module("tests.standard_space").make_for_one()


class Once:
    """Does what would be the same for all who run the tests, and leaves them what is not."""

    def pytest_collectreport(self, report: Any) -> None:
        """What ended in the middle of its import, by an error or a skip, is imported anew."""
        for name, module in list(sys.modules.items()) if not report.passed else ():
            if (getattr(module, "__file__", None) or "").endswith(f"/{report.nodeid}"):
                del sys.modules[name]

    def pytest_collection_finish(self, session: Any) -> None:
        """Look for the parts of the system that tests need: for some, another Python has to import something."""
        missing = importlib.import_module("tests.system").missing
        for part in {part for item in session.items for marker in item.iter_markers("needs") for part in marker.args}:
            missing(part)


def collect(arguments: list[str]) -> None:
    """Import all files of tests, with their assertions rewritten; those that fail are left to who runs the tests."""
    without = ("cacheprovider", "rerunfailures", "xdist")  # they write a file, have a thread, and start processes
    unused = [word for plugin in without for word in ("-p", f"no:{plugin}")]
    importlib.import_module("pytest").main([*arguments, "--collect-only", "-qq", *unused], [Once()])


def await_one_thread() -> None:
    """Wait until no other thread is left, since what is forked off has one alone."""
    end = time.monotonic() + 60
    most = 1 + (THREADS_OF_ROS if "rclpy" in sys.modules else 0)
    while (threads := len(os.listdir("/proc/self/task"))) > most:  # one that has done its work is there a moment longer
        assert time.monotonic() < end, f"{threads} threads: a process that is forked off has one alone"
        time.sleep(0.01)


def run(request: dict[str, Any], told: int | None) -> None:
    """Run the program, and end as Python does: but nothing is taken apart, which would copy all that was forked.

    What its children have computed of which the system does not know that they are its own goes to `told`.
    """
    try:
        if request["is_module"]:
            runpy.run_module(request["program"], run_name="__main__", alter_sys=True)
        else:
            runpy.run_path(request["program"], run_name="__main__")
        code = 0
    except SystemExit as end:
        if not isinstance(end.code, int | None):
            raise
        code = end.code or 0
    internals: Any = threading
    internals._shutdown()  # waits for its threads
    internals = atexit
    internals._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    if told is not None:
        with contextlib.suppress(BrokenPipeError):
            os.write(told, f"beside {forked_children.computed_beside_s():.2f}\n".encode())
    os._exit(code & 0xFF)


if __name__ == "__main__":
    gc.disable()
    listens, *given = sys.argv[1:]
    listener = None if listens == COLLECT else socket.socket(fileno=int(listens))
    with socket.socket(fileno=os.dup(0)) as channel:
        chosen = Server(channel, listener, functools.partial(prepare if listener else collect, given)).serve()
    if chosen is not None:
        told = chosen["told"]
        if told is not None and (asked := forked_children.fork()):
            (chosen, streams), told = asked, None
            become(chosen, streams)
        run(chosen, told)
