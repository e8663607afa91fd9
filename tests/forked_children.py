"""Children of a forked program that need not import what they need either.

A demonstration starts a dozen programs in Python, each of which would compute for a second until it begins. Here the
process of the demonstration has one beside it that was forked off it before it began, and forks such children from now
on (`fork`). They are its own children, as those that it starts otherwise: what forks twice leaves what it has forked to
the nearest process above it that takes orphans.

Those that need the other Python, which has rospy, are forked off the process that has it for all tests. To the system
they are no children of the demonstration: it is told of their ends (`_waitpid`), and they of its end.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
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
from pathlib import Path
from typing import Any, Final

from tests.forking import SharedForkServer, command_of, how_it_was

__all__ = ["computed_beside_s", "fork", "fork_beside"]

_BYTES: Final = 1 << 17
_PR_SET_PDEATHSIG: Final = 1
_PR_SET_CHILD_SUBREAPER: Final = 36
_ENDS_WITH_PARENT: Final = ["setpriv", "--pdeathsig", "TERM"]
"""What `ua_fleet.bridge.children` begins a command with."""
_popen: Final[Any] = subprocess.Popen
_execute_child: Final = _popen._execute_child
_of_system: Final = os.waitpid
_beside: Final[dict[int, socket.socket]] = {}
"""What runs in the other Python: process ids, with what tells of their ends."""
_beside_s: Final[list[float]] = []
_taking: Final = threading.Lock()


def computed_beside_s() -> float:
    """Seconds that those have computed that ran in the other Python and have ended."""
    return sum(_beside_s)


def _waitpid(pid: int, options: int) -> tuple[int, int]:
    """As `os.waitpid`, for those in the other Python too."""
    if (ended := _beside.get(pid)) is None:
        return _of_system(pid, options)
    if not select.select([ended], [], [], 0 if options & os.WNOHANG else None)[0]:
        return 0, 0
    with _taking:
        if _beside.pop(pid, None) is None:
            raise ChildProcessError(errno.ECHILD, "another thread was told of its end")
        code, seconds = how_it_was(ended)
        _beside_s.append(seconds)
    return pid, code << 8 if code >= 0 else -code


def _have_waited() -> None:
    """Have `_waitpid` called for all children of this process."""
    modules: tuple[Any, ...] = os, getattr(subprocess, "_del_safe", None)  # the latter from Python 3.12 on
    for module in filter(None, modules):
        module.waitpid = _waitpid
    poll = _popen._internal_poll
    poll.__defaults__ = tuple(_waitpid if value is _of_system else value for value in poll.__defaults__)


@functools.cache
def _server_beside(python: str) -> SharedForkServer | None:
    with contextlib.suppress(ConnectionRefusedError):
        return SharedForkServer(python)
    return None


def _prctl(option: int, value: int) -> None:
    if ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "prctl")


def _serve(requests: socket.socket, parent: int) -> tuple[dict[str, Any], list[int]]:
    """Fork until the socket is closed, which ends this process. Returns in the processes that are forked."""
    while True:
        data, descriptors, _, _ = socket.recv_fds(requests, _BYTES, 3)
        if not data:
            os._exit(0)
        between = os.fork()
        if between:
            os.waitpid(between, 0)
            for descriptor in descriptors:
                os.close(descriptor)
            continue
        if os.fork():
            os._exit(0)
        while os.getppid() == between or os.getppid() != parent:
            if not Path(f"/proc/{parent}").exists():
                os._exit(1)
            time.sleep(0.001)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        request: dict[str, Any] = json.loads(data)
        if request["ends_with_parent"]:
            _prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        requests.send(str(os.getpid()).encode())
        requests.detach()
        return request, descriptors


def _start(requests: socket.socket | None, popen: Any, given: tuple[Any, ...]) -> None:
    """As `subprocess.Popen._execute_child` with what that is given."""
    args, _, preexec_fn, _, pass_fds, folder, environment, _, _, is_shell = given[:10]
    pipes, has_session = given[10:16], given[-2]
    words = [] if is_shell or isinstance(args, str | bytes | os.PathLike) else [os.fsdecode(word) for word in args]
    ends_with_parent = words[:3] == _ENDS_WITH_PARENT
    command = command_of(words[3:] if ends_with_parent else words) if words else None
    is_ours = requests is not None and command is not None and command.python == sys.executable
    server = None if is_ours or command is None or not has_session else _server_beside(command.python)
    if command is None or not (is_ours or server) or preexec_fn is not None or pass_fds:
        _execute_child(popen, *given)
        return
    request: dict[str, Any] = {
        "program": command.program,
        "is_module": command.is_module,
        "arguments": command.arguments,
        "environment": dict(os.environ if environment is None else environment),
        "folder": os.getcwd() if folder is None else os.fspath(folder),
        "has_session": bool(has_session),
        "ends_with_parent": ends_with_parent,
    }
    streams = [own if own >= 0 else usual for own, usual in zip((pipes[0], pipes[3], pipes[5]), range(3), strict=True)]
    if server is None:
        assert requests is not None
        socket.send_fds(requests, [json.dumps(request).encode()], streams)
        popen.pid = int(requests.recv(32))
    else:
        ended, told = socket.socketpair()
        with told:
            popen.pid = server.fork(request, [*streams, told.fileno()])
        _beside[popen.pid] = ended
    popen._child_created = True
    popen._close_pipe_fds(*pipes)


def fork() -> tuple[dict[str, Any], list[int]] | None:
    """Have this process fork its children from what it is now; what one is asked for, in each of them, else None."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    parent = os.getpid()
    if os.fork() == 0:
        ours.close()
        for number in (
            signal.SIGINT,
            signal.SIGTERM,
        ):  # they are for the whole group, and this one ends with its parent
            signal.signal(number, signal.SIG_IGN)
        return _serve(its, parent)
    its.close()
    _have_forked(ours)
    return None


def fork_beside() -> None:
    """Have this process, which was not forked itself, have its children forked off those that fork for all tests."""
    _have_forked(None)


def _have_forked(requests: socket.socket | None) -> None:
    lock = threading.Lock()

    def execute_child(popen: Any, *given: Any) -> None:
        with lock:
            _start(requests, popen, given)

    _popen._execute_child = execute_child
    _have_waited()
