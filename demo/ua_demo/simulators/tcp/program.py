"""The small program on a robot for `interpreter` mode, as one writes it in RAPID or KRL: bytes in, one after the other.

It is written as such a program is, with as little as those languages have, and from the page in docs/tcp.md alone: it
shares no code with the bridge.
"""

from __future__ import annotations

import socket
import time
from typing import Final

from ua_demo.simulators.tcp.robot import Job, Robot, Unable

__all__ = ["Program"]

TURN_S: Final = 0.01


class Closed(Exception):
    """The connection is gone."""


class Program:
    """One connection's worth of the program."""

    def __init__(self, robot: Robot, framing: str, terminator: bytes, length: int, ask: str = "") -> None:
        """`ask` is the name of data of another robot that it asks for each second."""
        self._robot = robot
        self._framing, self._terminator, self._length, self._ask = framing, terminator, length, ask
        self._open: dict[int, str] = {}

    def serve(self, connection: socket.socket) -> None:
        """Take commands until the connection ends."""
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connection
        self._open.clear()
        next_second = time.monotonic()
        try:
            while True:
                connection.settimeout(TURN_S)
                try:
                    first = connection.recv(1)
                except TimeoutError:
                    first = None
                connection.settimeout(None)
                if first is not None:
                    self._take(first)
                self._tell_changes()
                if time.monotonic() >= next_second:
                    next_second += 1.0
                    x, y = self._robot.position
                    self._send("information", "position", 0, (f"{x:g}", f"{y:g}"))
                    if self._ask:
                        self._send("request", self._ask, 7, ())
        except (OSError, Closed):
            return

    # Fields

    def _byte(self) -> bytes:
        byte = self._socket.recv(1)
        if not byte:
            raise Closed
        return byte

    def _field(self, first: bytes = b"") -> str:
        if first == b"" and self._framing != "acknowledged":
            first = self._byte()
        if self._framing == "length":
            data = first
            while len(data) < self._length:
                data += self._byte()
            return data.decode("ascii").rstrip(" ")
        if self._framing == "terminator":
            data = first
            while not data.endswith(self._terminator):
                data += self._byte()
            return data[: -len(self._terminator)].decode("ascii")
        data = first + (b"" if first else self._byte())
        self._socket.settimeout(0.0)  # all that is there is the field, since the next is sent after our `ack`
        try:
            while more := self._socket.recv(255):
                data += more
        except BlockingIOError:
            pass
        finally:
            self._socket.settimeout(None)
        self._write("ack")
        return data.decode("ascii").strip(" ")

    def _write(self, field: str) -> None:
        data = field.encode("ascii")
        self._socket.sendall(data.ljust(self._length) if self._framing == "length" else data + self._terminator)

    def _send(self, kind: str, subtype: str, number: int, data: tuple[str, ...]) -> None:
        for field in (kind, subtype, str(number), str(len(data)), *data):
            self._write(field)

    # Messages

    def _take(self, first: bytes) -> None:
        if first == b"":
            raise Closed
        kind = self._field(first)
        subtype, number, size = self._field(), int(self._field()), int(self._field())
        data = tuple([self._field() for _ in range(size)])
        if kind in ("command", "request"):
            self._begin(number, subtype, data)
        elif kind == "query":
            self._query(number, subtype)
        elif kind == "halt":
            self._robot.halt(number)
        elif kind == "information":
            print("information", subtype, *data, flush=True)

    def _begin(self, number: int, skill: str, arguments: tuple[str, ...]) -> None:
        try:
            job = self._robot.begin(number, skill, arguments)
        except (Unable, ValueError) as error:
            self._send("status", "refused", number, (str(error),))
            return
        self._tell(job)

    def _query(self, number: int, skill: str) -> None:
        job = self._robot.find(number)
        if job is not None and job.skill == skill:
            self._tell(job)
        else:
            self._send("status", "never" if self._robot.remembers else "unknown", number, ())

    def _tell(self, job: Job) -> None:
        state, data = self._robot.state(job)
        self._open[job.number] = state
        if state != "running":
            del self._open[job.number]
        self._send("status", state, job.number, data)

    def _tell_changes(self) -> None:
        for number in list(self._open):
            job = self._robot.find(number)
            if job is not None and self._robot.state(job)[0] != "running":
                self._tell(job)
