"""A robot that takes commands in a language of its own, one in each line, for `direct` mode.

WORK "<work>" <seconds>     RUNNING, then DONE "<work>" <seconds> or ERROR <why>; at once ERROR for what it refuses
MOVE <x> <y> <seconds>      DONE
SPEED <value>               nothing
POS?                        POS <x> <y>
STOP                        ends all that is under way; STOPPED
"""

from __future__ import annotations

import re
import socket
import time
from typing import Final

from ua_demo.simulators.tcp.robot import Job, Robot, Unable

__all__ = ["CommandLine"]

TURN_S: Final = 0.01
_WORK: Final = re.compile(r'WORK "([^"]*)" (\S+)')


class CommandLine:
    """The robot's command socket."""

    def __init__(self, robot: Robot) -> None:
        self._robot, self._number = robot, 0
        self._open: list[Job] = []

    def serve(self, connection: socket.socket) -> None:
        """Take commands until the connection ends."""
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(TURN_S)
        self._open.clear()
        left = b""
        try:
            while True:
                try:
                    data = connection.recv(4096)
                    if not data:
                        return
                    *lines, left = (left + data).split(b"\n")
                    for line in lines:
                        self._take(line.decode("utf-8"), connection)
                except TimeoutError:
                    pass
                self._tell_ends(connection)
        except OSError:
            return

    def _take(self, line: str, connection: socket.socket) -> None:
        words = line.split()
        if line == "POS?":
            x, y = self._robot.position
            connection.sendall(f"POS {x:g} {y:g}\n".encode())
        elif line == "STOP":
            for job in self._open:
                self._robot.halt(job.number)
            self._open.clear()
            connection.sendall(b"STOPPED\n")
        elif line.startswith("SPEED "):
            print("speed", words[1], flush=True)
        elif work := _WORK.fullmatch(line):
            self._begin("work", (work[1], work[2]), connection)
        elif words[:1] == ["MOVE"]:
            self._begin("move", tuple(words[1:]), connection)
        else:
            connection.sendall(b"ERROR no such command\n")

    def _begin(self, skill: str, arguments: tuple[str, ...], connection: socket.socket) -> None:
        self._number = int(time.time() * 1000) % 2**31
        try:
            self._open.append(self._robot.begin(self._number, skill, arguments))
        except (Unable, ValueError) as error:
            connection.sendall(f"ERROR {error}\n".encode())

    def _tell_ends(self, connection: socket.socket) -> None:
        for job in list(self._open):
            state, data = self._robot.state(job)
            if state == "running":
                continue
            self._open.remove(job)
            if state == "failed":
                connection.sendall(f"ERROR {data[0]}\n".encode())
            elif job.skill == "work":
                connection.sendall(f'DONE "{data[0]}" {data[1]}\n'.encode())
            else:
                connection.sendall(b"DONE\n")
