"""Robots that speak over TCP: programs that take one field after the other.

For skills it is the simulated robot, which acknowledges each field. For data it is a program here, in a thread, which
shows what it is told to, with a terminator after each field; it is written from docs/tcp.md and shares no code with the
bridge.
"""

from __future__ import annotations

import json
import signal
import socket
import sys
import threading
import time
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, Final

from ua_bridges.tcp.config import Framing, InterpreterLink, TcpBridgeConfig
from ua_bridges.tcp.driver import create_driver

from tests import system
from tests.contract.harness import FAULT_ID, NUMBER, TEXT, TWIST, WORK, Kind
from ua_fleet.bridge import Driver
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig
from ua_fleet.topics import SERVER_SPACE, Topic

NEEDS: tuple[str, ...] = ()
WARNINGS: tuple[str, ...] = ()

SPACE: Final = 300
SIX: Final = ", ".join(f"{part}.{axis}: {{type: Double}}" for part in ("linear", "angular") for axis in "xyz")
FLEET: Final = f"""
version: 1
pubsub: {{security: none}}
bridges:
  cell: {{kind: tcp, space: {SPACE}, status_id: 1, interpreter: {{connect: "127.0.0.1:PORT", encoding: utf-8}}}}
robots:
  machine:
    bridge: cell
    data:
      number: {{id: 11, type: Double}}
      text: {{id: 12, type: String}}
      twist: {{id: 13, fields: {{{SIX}}}}}
      speed: {{id: 14, type: Double, origin: server}}
      goal: {{id: 15, origin: server, fields: {{{SIX}}}}}
"""
SHOWN: Final = {Topic(SPACE, 2, 11): "number", Topic(SPACE, 2, 12): "text", Topic(SPACE, 2, 13): "twist"}
TAKEN: Final = {Topic(SERVER_SPACE, 2, 14): "speed", Topic(SERVER_SPACE, 2, 15): "goal"}


def _is_open(end: socket.socket) -> bool:
    try:
        return end.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False


class Program:
    """See MappedRobot: a program on a robot that has values and takes values."""

    def __init__(self, port: int) -> None:
        self._address = ("127.0.0.1", port)
        self._socket: socket.socket | None = None
        self._taken: list[tuple[str, tuple[float, ...]]] = []
        self.come_back()

    def show(self, topic: Topic, values: Sequence[Any]) -> None:
        """See MappedRobot."""
        deadline = time.monotonic() + 10
        while (bridge := self._socket) is None or not _is_open(bridge):  # the one before may have just left
            assert time.monotonic() < deadline, "the bridge does not connect"
            time.sleep(0.01)
        fields = ("information", SHOWN[topic], 0, len(values), *values)
        bridge.sendall("".join(f"{field}\n" for field in fields).encode())

    def taken(self, topic: Topic) -> list[tuple[Any, ...]]:
        """See MappedRobot."""
        return [values for name, values in self._taken if name == TAKEN[topic]]

    def leave(self) -> None:
        """See MappedRobot."""
        self._gone.set()
        for end in (self._listener, self._socket):
            if end is not None:
                with suppress(OSError):  # it may be closed already
                    end.shutdown(socket.SHUT_RDWR)
                end.close()
        self._thread.join(10)
        assert not self._thread.is_alive()

    def misbehave(self) -> None:
        """See MappedRobot."""
        assert self._socket is not None
        self._socket.sendall(b"\xff\xfe\n")

    def behave(self) -> None:
        """See MappedRobot: it was no more than one line."""

    def come_back(self) -> None:
        """See MappedRobot."""
        self._gone, self._socket = threading.Event(), None
        self._listener = socket.create_server(self._address)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._gone.is_set():
            try:
                self._socket, _ = self._listener.accept()
                if self._gone.is_set():  # it went while this bridge was let in, and may not have seen it
                    self._socket.shutdown(socket.SHUT_RDWR)
                with self._socket, self._socket.makefile(encoding="utf-8", newline="\n") as fields:
                    while (kind := fields.readline().rstrip("\n")) != "":
                        name, _, size = (fields.readline().rstrip("\n") for _ in range(3))
                        values = tuple([float(fields.readline()) for _ in range(int(size))])
                        assert kind == "information"
                        self._taken.append((name, values))
            except OSError:
                pass


class MappedTcpSpace:
    """See MappedSpace."""

    own_work = "ua_bridges.tcp.interpreter.InterpreterSession.turn"
    is_sampled = False

    def __init__(self, port: int) -> None:
        self.number = SPACE
        self.sources: Mapping[Topic, Kind] = dict(zip(SHOWN, (NUMBER, TEXT, TWIST), strict=True))
        self.sinks: Mapping[Topic, Kind] = dict(zip(TAKEN, (NUMBER, TWIST), strict=True))
        self._port = port
        self._config = load_content(FLEET.replace("PORT", str(port)).encode(), "fleet.yaml", {})
        self._robot: Program | None = None

    @property
    def robot(self) -> Program:
        """See MappedSpace."""
        assert self._robot is not None
        return self._robot

    def make_driver(self) -> Driver:
        """See MappedSpace."""
        return create_driver(self._config, "cell")

    def appear(self) -> None:
        """See MappedSpace."""
        self._robot = Program(self._port)

    def close(self) -> None:
        """End the robot."""
        if self._robot is not None:
            self._robot.leave()


@asynccontextmanager
async def open_mapped_space(folder: Path, processes: system.Processes) -> AsyncGenerator[MappedTcpSpace]:
    """A robot whose program sends and takes information."""
    space = MappedTcpSpace(system.free_tcp_port())
    try:
        yield space
    finally:
        space.close()


class SkilledTcpSpace:
    """See SkilledSpace."""

    remembers = True

    def __init__(self, port: int, memory: Path, robot: system.Child) -> None:
        self._memory, self._robot = memory, robot
        self._config = self._configuration(port)

    def _configuration(self, port: int) -> FleetConfig:
        link = InterpreterLink(connect=f"127.0.0.1:{port}", framing=Framing.ACKNOWLEDGED)
        return FleetConfig.model_validate(
            {
                "version": 1,
                "pubsub": {"security": "none"},
                "bridges": {"cell": TcpBridgeConfig(kind="tcp", space=SPACE, interpreter=link)},
                "robots": {
                    "machine": {
                        "bridge": "cell",
                        "skill_status_id": 1902,
                        "fault_id": FAULT_ID,
                        "skills": {"work": WORK},
                    }
                },
            }
        )

    def make_driver(self) -> Driver:
        """See SkilledSpace."""
        return create_driver(self._config, "cell")

    def told(self) -> list[str]:
        """See SkilledSpace."""
        if not self._memory.exists():
            return []
        return [json.loads(line)[2][0] for line in self._memory.read_text().splitlines()]

    def freeze(self) -> None:
        """See SkilledSpace."""
        self._robot.freeze()

    def cut(self) -> None:
        """See SkilledSpace."""
        self._robot.end(signal.SIGKILL)


@asynccontextmanager
async def open_skilled_space(folder: Path, processes: system.Processes) -> AsyncGenerator[SkilledTcpSpace]:
    """A robot whose program acknowledges each field, and remembers what it was told."""
    memory = folder / "memory"
    robot = processes.start(
        *(sys.executable, "-u", "-m", "ua_demo.simulators.tcp", "--listen", "127.0.0.1:0"),
        *("--framing", "acknowledged", "--memory", memory),
        env=system.clean_environment(PYTHONPATH="demo"),
    )
    port = int(robot.wait_for("ready").split()[1])
    yield SkilledTcpSpace(port, memory, robot)
