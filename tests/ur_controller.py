"""A simulated Universal Robots controller in a process of its own, on an address of its own."""

from __future__ import annotations

import json
import os
import random
import socket
import sys
from pathlib import Path
from typing import Any, Final

from tests import system

__all__ = ["UrController", "dashboard", "free_loopback"]

_DASHBOARD: Final = 29999
_PROVOKING: Final = 30005


def free_loopback() -> str:
    """A loopback address that no controller has: ur-rtde takes no other ports than the usual ones."""
    while True:
        host = f"127.{random.randint(1, 254)}.{random.randint(0, 254)}.{random.randint(2, 254)}"
        with socket.socket() as probe:
            try:
                probe.bind((host, _DASHBOARD))
            except OSError:
                continue
        return host


def dashboard(host: str, *commands: str) -> None:
    """Tell the dashboard server something, as the teach pendant does."""
    with socket.create_connection((host, _DASHBOARD), 5) as connection, connection.makefile("rw") as lines:
        lines.readline()
        for command in commands:
            lines.write(f"{command}\n")
            lines.flush()
            lines.readline()


class UrController:
    """Not up until it is started."""

    def __init__(self, processes: system.Processes, *options: str | Path, host: str | None = None) -> None:
        self.host = host or free_loopback()
        self._processes, self._options = processes, options
        self._child: system.Child | None = None

    def start(self) -> None:
        """Switch it on, ready to move unless the options say otherwise."""
        command = (sys.executable, "-m", "ua_demo.simulators.ur", "--host", self.host, *self._options)
        environment = system.clean_environment(PYTHONPATH="bridges:demo", PYTHONUNBUFFERED="1")
        self._child = self._processes.start(*command, env=environment)
        self._child.wait_for("ready")

    def end(self) -> None:
        """Switch it off."""
        assert self._child is not None
        self._child.end()

    @property
    def pid(self) -> int:
        """Of its process."""
        assert self._child is not None
        return self._child.process.pid

    def signal(self, number: int) -> None:
        """Send its process a signal."""
        os.kill(self.pid, number)

    def do(self, deed: str, **rest: Any) -> dict[str, Any]:
        """What only a simulator has: see `ua_demo.simulators.ur.provoking`."""
        with socket.create_connection((self.host, _PROVOKING), 5) as connection, connection.makefile("rw") as lines:
            lines.write(json.dumps({"do": deed, **rest}) + "\n")
            lines.flush()
            answer: dict[str, Any] = json.loads(lines.readline())
        assert "error" not in answer, answer
        return answer

    def state(self) -> dict[str, Any]:
        """Its modes, joints and outputs."""
        return self.do("state")

    def log(self) -> list[str]:
        """The texts that it logged."""
        return [text for _, text, _ in self.do("log")["log"]]
