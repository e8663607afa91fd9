"""An end of stock rospy programs that computes nothing.

rospy closes the listening socket of its node under the thread that polls it: from then on each poll returns at once,
each accept fails, and the thread goes round until its process has ended, for a quarter of a second.
"""

from __future__ import annotations

import importlib
import socketserver
from typing import Any

__all__ = ["keep"]


def _get_request(server: Any) -> Any:
    try:
        return socketserver.TCPServer.get_request(server)
    except OSError:
        if server.socket.fileno() < 0:
            server._BaseServer__shutdown_request = True  # what its `shutdown` sets
        raise


def keep() -> None:
    """Have each server end by its first accept that fails since its socket is closed."""
    server: Any = importlib.import_module("rosgraph.xmlrpc").ThreadingXMLRPCServer
    server.get_request = _get_request
