"""A robot on a socket, in a process of its own, that answers each command with the time at which it had all of it."""

from __future__ import annotations

import socket
import sys
import time

BATCH = 5


def line_robot(connection: socket.socket) -> None:
    """Direct mode: one line is one command."""
    left = b""
    while data := connection.recv(4096):
        left += data
        if left.endswith(b"\n"):
            connection.sendall(b"OK %d\n" % time.monotonic_ns())
            left = b""


def field_robot(connection: socket.socket, *, acknowledges: bool) -> None:
    """Interpreter mode: five fields are one command."""
    left = b""
    fields: list[bytes] = []
    while data := connection.recv(4096):
        left += data
        if acknowledges:
            fields.append(left)
            left = b""
            connection.sendall(b"ack\n")
        elif left.endswith(b"\n"):
            fields += left[:-1].split(b"\n")
            left = b""
        if len(fields) == BATCH:
            at = time.monotonic_ns()
            connection.sendall(b"status\ndone\n%s\n1\n%d\n" % (fields[2], at))
            fields = []


def main(mode: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        print("ready", listener.getsockname()[1], flush=True)
        while True:
            connection, _ = listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with connection:
                if mode == "direct":
                    line_robot(connection)
                else:
                    field_robot(connection, acknowledges=mode == "acknowledged")


if __name__ == "__main__":
    main(sys.argv[1])
