"""Starts programs of tests as processes that have imported already what they need: `fork_server.py MODULE...`.

The socket on file descriptor 0 brings requests: the program, its arguments and its environment as JSON, and with them
two file descriptors, for what the process prints and for how it ends. Each is answered with the process id. What runs
is the program, in a process and a group of its own; only its imports were done before. An ended process is there until
nobody holds the other end of the second descriptor, so that no other one has its id. Ends when the socket is closed.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import runpy
import select
import socket
import sys
from typing import Any

REQUEST_BYTES = 1 << 16


def become(program: str, arguments: list[str], environment: dict[str, str], output: int) -> None:
    """Be a process of its own, as one that was started with this environment and these arguments."""
    os.setpgid(0, 0)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for source, target in ((nothing, 0), (output, 1), (output, 2)):
        os.dup2(source, target)
    os.closerange(3, 256)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = [program, *arguments]
    gc.enable()


def serve(requests: socket.socket) -> str | None:
    """Start processes until the socket is closed; in such a process, the program that it is to run."""
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
                with contextlib.suppress(BrokenPipeError):
                    os.write(told, str(how.si_status if how.si_code == os.CLD_EXITED else -how.si_status).encode())
                ended[told] = pid
            elif found in ended:
                os.waitpid(ended.pop(found), 0)
            else:
                continue
            os.close(found)
        if requests.fileno() not in readable:
            continue
        data, descriptors, _, _ = socket.recv_fds(requests, REQUEST_BYTES, 2)
        if not data:
            return None
        request: dict[str, Any] = json.loads(data)
        output, told = descriptors
        pid = os.fork()
        if pid == 0:
            requests.detach()  # closed with all the others
            become(request["program"], request["arguments"], request["environment"], output)
            return str(request["program"])
        with contextlib.suppress(OSError):  # it has done so itself, or is gone
            os.setpgid(pid, pid)
        os.close(output)
        running[os.pidfd_open(pid)] = pid, told
        requests.send(str(pid).encode())


if __name__ == "__main__":
    gc.disable()
    for module in sys.argv[1:]:
        importlib.import_module(module)
    gc.freeze()
    with socket.socket(fileno=os.dup(0)) as channel:
        chosen = serve(channel)
    if chosen is not None:
        runpy.run_path(chosen, run_name="__main__")
