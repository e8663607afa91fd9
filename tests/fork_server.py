"""Starts programs of tests as processes that have imported already what they need: `fork_server.py MODULE...`.

Or, for the processes that run tests (`forked_workers`), the files of these: `fork_server.py --collect FILE...`.

The socket on file descriptor 0 brings requests: what is run, its arguments, environment and folder as JSON, and with
them four file descriptors: what the process reads, where it prints, where it complains, and where is told how it ends.
Each is answered with the process id. What runs is the program, in a process and a group of its own; only its imports
were done before, and the nodes that the standard gives an OPC UA server. An ended process is there until nobody holds
the other end of the last descriptor, so that no other one has its id. Ends when the socket is closed.
"""

from __future__ import annotations

import atexit
import contextlib
import faulthandler
import gc
import importlib
import json
import os
import runpy
import select
import socket
import sys
import threading
import time
from typing import Any

from tests import forked_children

REQUEST_BYTES = 1 << 17
COLLECT = "--collect"


def become(request: dict[str, Any], descriptors: list[int]) -> None:
    """Be a process of its own, as one that was started with this environment and these arguments."""
    has_session = request.get("has_session")
    if has_session:
        os.setsid()
    elif has_session is None:  # of a child that a program has started, which stays in its group
        os.setpgid(0, 0)
    kept = [os.dup(descriptor) for descriptor in descriptors]  # above those that they become
    for source, target in zip(kept, range(3), strict=True):
        os.dup2(source, target)
    os.closerange(3, 256)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    time.tzset()
    program = request["program"]
    sys.argv = [program, *request["arguments"]]
    sys.path[0] = request["folder"] if request["is_module"] else os.path.dirname(os.path.abspath(program))
    faulthandler.enable()  # one that has to be killed says by SIGABRT where it stands
    sys.path[1:1] = [place for place in os.environ.get("PYTHONPATH", "").split(os.pathsep) if place]
    gc.enable()


def computed_s(pid: int) -> float:
    """Seconds that a process has computed that has ended and is not waited for yet, with its children."""
    with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as stat:
        fields = stat.read().rpartition(")")[2].split()
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def serve(requests: socket.socket) -> dict[str, Any] | None:
    """Start processes until the socket is closed; in such a process, what was asked for."""
    running: dict[int, tuple[int, int]] = {}
    """Process ids by the descriptors that tell of their ends, each with where to write how it was."""
    ended: dict[int, int] = {}
    """Process ids by the descriptors where that was written."""
    while True:
        readable, _, _ = select.select([requests.fileno(), *running, *ended], [], [])
        for found in readable:
            if found in running:
                pid, told = running.pop(found)
                how = os.waitid(os.P_PIDFD, found, os.WEXITED | os.WNOWAIT)
                assert how is not None
                code = how.si_status if how.si_code == os.CLD_EXITED else -how.si_status
                with contextlib.suppress(BrokenPipeError):
                    os.write(told, f"{code} {computed_s(pid):.2f}".encode())
                ended[told] = pid
            elif found in ended:
                os.waitpid(ended.pop(found), 0)
            else:
                continue
            os.close(found)
        if requests.fileno() not in readable:
            continue
        data, descriptors, _, _ = socket.recv_fds(requests, REQUEST_BYTES, 4)
        if not data:
            return None
        request: dict[str, Any] = json.loads(data)
        *streams, told = descriptors
        pid = os.fork()
        if pid == 0:
            requests.detach()  # closed with all the others
            become(request, streams)
            return request
        if request.get("has_session") is None:
            with contextlib.suppress(OSError):  # it has done so itself, or is gone
                os.setpgid(pid, pid)
        for stream in streams:
            os.close(stream)
        running[os.pidfd_open(pid)] = pid, told
        requests.send(str(pid).encode())


def prepare(modules: list[str]) -> None:
    """Do what all processes would do alike."""
    importlib.import_module("tests.known_keys").keep()
    for module in modules:
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    importlib.import_module("tests.command_tree").keep()
    if (command_line := sys.modules.get("ua_fleet.cli.app")) is not None:
        importlib.import_module("typer.main").get_command(command_line.app)
    if "ua_fleet.server.app" in sys.modules:
        importlib.import_module("tests.standard_space").make_for_one()


class Unfinished:
    """Has what ended in the middle of its import, by an error or a skip, be imported anew by who runs the tests."""

    def pytest_collectreport(self, report: Any) -> None:
        """A file has been collected."""
        for name, module in list(sys.modules.items()) if not report.passed else ():
            if (getattr(module, "__file__", None) or "").endswith(f"/{report.nodeid}"):
                del sys.modules[name]


def collect(arguments: list[str]) -> None:
    """Import all files of tests, with their assertions rewritten; those that fail are left to who runs the tests."""
    without = ("cacheprovider", "rerunfailures", "xdist")  # they write a file, have a thread, and start processes
    unused = [word for plugin in without for word in ("-p", f"no:{plugin}")]
    importlib.import_module("pytest").main([*arguments, "--collect-only", "-qq", *unused], [Unfinished()])


def await_one_thread() -> None:
    """Wait until no other thread is left, since what is forked off has one alone."""
    end = time.monotonic() + 60
    while (threads := len(os.listdir("/proc/self/task"))) > 1:  # one that has done its work is there a moment longer
        assert time.monotonic() < end, f"{threads} threads: a process that is forked off has one alone"
        time.sleep(0.01)


def run(request: dict[str, Any]) -> None:
    """Run the program, and end as Python does: but nothing is taken apart, which would copy all that was forked."""
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
    os._exit(code & 0xFF)


if __name__ == "__main__":
    gc.disable()
    if sys.argv[1] == COLLECT:
        collect(sys.argv[2:])
    else:
        prepare(sys.argv[1:])
    await_one_thread()
    gc.collect()
    gc.freeze()
    with socket.socket(fileno=os.dup(0)) as channel:
        chosen = serve(channel)
    if chosen is not None:
        if chosen["is_module"] and chosen["arguments"][:1] == ["demo"] and (asked := forked_children.fork()):
            chosen, streams = asked
            become(chosen, streams)
        run(chosen)
