"""Children of a forked program that need not import what they need either.

A demonstration starts a dozen programs in Python, each of which would compute for a second until it begins. Here the
process of the demonstration has one beside it that was forked off it before it began, and forks such children from now
on (`fork`). They are its own children, as those that it starts otherwise: what forks twice leaves what it has forked to
the nearest process above it that takes orphans.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any, Final

from tests.forking import command_of

__all__ = ["fork"]

_BYTES: Final = 1 << 17
_PR_SET_PDEATHSIG: Final = 1
_PR_SET_CHILD_SUBREAPER: Final = 36
_ENDS_WITH_PARENT: Final = ["setpriv", "--pdeathsig", "TERM"]
"""What `ua_fleet.bridge.children` begins a command with."""
_popen: Final[Any] = subprocess.Popen
_execute_child: Final = _popen._execute_child


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


def _start(requests: socket.socket, popen: Any, given: tuple[Any, ...]) -> None:
    """As `subprocess.Popen._execute_child` with what that is given."""
    args, _, preexec_fn, _, pass_fds, folder, environment, _, _, is_shell = given[:10]
    pipes, has_session = given[10:16], given[-2]
    words = [] if is_shell or isinstance(args, str | bytes | os.PathLike) else [os.fsdecode(word) for word in args]
    ends_with_parent = words[:3] == _ENDS_WITH_PARENT
    command = command_of(words[3:] if ends_with_parent else words) if words else None
    if command is None or command.python != sys.executable or preexec_fn is not None or pass_fds:
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
    socket.send_fds(requests, [json.dumps(request).encode()], streams)
    popen.pid = int(requests.recv(32))
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
    lock = threading.Lock()

    def execute_child(popen: Any, *given: Any) -> None:
        with lock:
            _start(ours, popen, given)

    _popen._execute_child = execute_child
    return None
