"""A Parrot drone whose program can open a socket and read one field after the other (interpreter mode, docs/tcp.md).

It needs nothing but a socket and a clock. It remembers the last number that it was told, with how that stands, as long
as it runs; a connection that is lost changes nothing in the air.
"""

from __future__ import annotations

import argparse
import contextlib
import socket
import threading
import time
from typing import Final

from ua_demo.report import beat, report

SECONDS: Final = {"take_off": 6.0, "land": 6.0}
THROUGH: Final = {"take_off": "taking off", "land": "landing"}
END: Final = {"take_off": "hovering", "land": "landed"}
BEAT_S: Final = 1.0


class Drone:
    """The drone's program."""

    def __init__(self, name: str, speed: float) -> None:
        self._name, self._speed = name, speed
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._number, self._state, self._flying = 0, "unknown", "landed"

    def serve(self, connection: socket.socket) -> None:
        """Do what one connection asks for, until it ends."""
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with self._lock:
            # A bridge that was cut off has left a connection that nobody ends: the newest one counts.
            if self._socket is not None:
                with contextlib.suppress(OSError):
                    self._socket.shutdown(socket.SHUT_RDWR)
            self._socket = connection
        self._send("information", "flying_state", 0, self._flying)
        fields = connection.makefile("r", encoding="ascii", newline="\n")
        while kind := fields.readline().strip():
            subtype, number, size = (fields.readline().strip() for _ in range(3))
            for _ in range(int(size)):
                fields.readline()
            if kind == "command":
                self._begin(subtype, int(number))
            elif kind == "query":
                self._tell(int(number))
        with self._lock:
            if self._socket is connection:
                self._socket = None

    def _begin(self, skill: str, number: int) -> None:
        if skill not in SECONDS:
            self._send("status", "refused", number, f"there is no {skill}")
        elif self._state == "running":
            self._send("status", "refused", number, f"it is {self._flying}")
        else:
            self._number, self._state = number, "running"
            report(self._name, f"begins {skill}", execution=number)
            self._tell(number)
            threading.Thread(target=self._fly, args=(skill, number), daemon=True).start()

    def _fly(self, skill: str, number: int) -> None:
        self._show(THROUGH[skill])
        time.sleep(SECONDS[skill] / self._speed)
        self._show(END[skill])
        self._state = "done"
        self._tell(number)

    def _show(self, flying: str) -> None:
        self._flying = flying
        self._send("information", "flying_state", 0, flying)

    def _tell(self, number: int) -> None:
        self._send("status", self._state if number == self._number else "unknown", number)

    def _send(self, kind: str, subtype: str, number: int, *data: str) -> None:
        fields = (kind, subtype, str(number), str(len(data)), *data)
        with self._lock:
            if self._socket is not None:
                try:
                    self._socket.sendall("".join(f"{field}\n" for field in fields).encode("ascii"))
                except OSError:
                    self._socket = None  # whoever connects next asks


def serve_until_over(drone: Drone, connection: socket.socket) -> None:
    """Serve a connection, however it ends."""
    with connection, contextlib.suppress(OSError):
        drone.serve(connection)


def _beat() -> None:
    while True:
        beat()
        time.sleep(BEAT_S)


def main() -> None:
    """Run the drone until it is ended."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (%(default)s)")
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--name", default="drone", help="as which it reports (%(default)s)")
    parser.add_argument("--speed", type=float, default=1.0)
    options = parser.parse_args()
    drone = Drone(options.name, options.speed)
    threading.Thread(target=_beat, name="heart", daemon=True).start()
    with socket.create_server((options.host, options.port)) as listener:
        report(options.name, "is ready")
        while True:
            connection, _ = listener.accept()
            threading.Thread(target=serve_until_over, args=(drone, connection), daemon=True).start()


if __name__ == "__main__":
    main()
