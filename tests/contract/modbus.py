"""A PLC for the contract suite: the real driver here, and a simulated PLC with the real protocol in its own process."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import threading
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

from ua_bridges.modbus.driver import create_driver

from tests import system
from tests.contract.harness import NUMBER, TEXT, TWIST, WAIT_S, Kind, Rubbish
from tests.forking import Command, ForkedProcess
from ua_fleet.bridge import Driver
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig
from ua_fleet.topics import Topic

NEEDS: tuple[str, ...] = ()
WARNINGS: tuple[str, ...] = ()

SPACE: Final = 300
OTHER_SPACE: Final = 77
FLEET: Final = """
version: 1
pubsub: {{security: none}}
bridges:
  plc:
    kind: modbus
    space: 300
    status_id: 1
    poll_s: 0.01
    devices:
      plc: {{host: 127.0.0.1, port: {port}, timeout_s: 1.5, retry_s: [0.05, 0.2], holding_registers: [[0, 9999]]}}
    mirrors:
      rover.speed: {{at: {{table: holding, address: 500, type: float64}}}}
      rover.pose:
        registers:
          linear.x: {{table: holding, address: 504, type: float64}}
          linear.y: {{table: holding, address: 508, type: float64}}
          linear.z: {{table: holding, address: 512, type: float64}}
          angular.x: {{table: holding, address: 516, type: float64}}
          angular.y: {{table: holding, address: 520, type: float64}}
          angular.z: {{table: holding, address: 524, type: float64}}
  other: {{kind: ros2, space: 77, status_id: 2}}
robots:
  rover:
    bridge: other
    data:
      speed: {{id: 1001, type: Double}}
      pose:
        id: 1002
        fields:
          linear.x: {{type: Double}}
          linear.y: {{type: Double}}
          linear.z: {{type: Double}}
          angular.x: {{type: Double}}
          angular.y: {{type: Double}}
          angular.z: {{type: Double}}
  machine:
    bridge: plc
    skill_status_id: 1902
    data:
      number: {{id: 11, type: Double, source: {{at: {{table: holding, address: 400, type: float64}}}}}}
      text: {{id: 12, type: String, source: {{at: {{table: holding, address: 410, type: string, length: 10}}}}}}
      pose:
        id: 13
        fields:
          linear.x: {{type: Double}}
          linear.y: {{type: Double}}
          linear.z: {{type: Double}}
          angular.x: {{type: Double}}
          angular.y: {{type: Double}}
          angular.z: {{type: Double}}
        source:
          registers:
            linear.x: {{table: holding, address: 420, type: float64}}
            linear.y: {{table: holding, address: 424, type: float64}}
            linear.z: {{table: holding, address: 428, type: float64}}
            angular.x: {{table: holding, address: 432, type: float64}}
            angular.y: {{table: holding, address: 436, type: float64}}
            angular.z: {{table: holding, address: 440, type: float64}}
    skills:
      work:
        id: 1900
        arguments: {{work: {{type: String}}, seconds: {{type: Double}}}}
        results: {{done: {{type: String}}, seconds: {{type: Double}}}}
        timeout_s: 20.0
        via:
          request: {{table: holding, address: 100}}
          accepted: {{table: holding, address: 101}}
          busy: {{table: holding, address: 102, bit: 0}}
          done: {{table: holding, address: 102, bit: 1}}
          error: {{table: holding, address: 102, bit: 2}}
          progress: {{table: holding, address: 103, type: uint16, scale: 0.01}}
          halt: {{table: holding, address: 104}}
          error_text: {{table: holding, address: 110, type: string, length: 20}}
          arguments:
            work: {{table: holding, address: 130, type: string, length: 20}}
            seconds: {{table: holding, address: 150}}
          results:
            done: {{table: holding, address: 160, type: string, length: 20}}
            seconds: {{table: holding, address: 180}}
          poll_s: 0.02
"""
"""The machine's registers are those of the simulator's program `work`."""


class PlcProcess:
    """A simulated PLC; see `ua_demo.simulators.modbus.__main__`."""

    def __init__(self, *options: str) -> None:
        self.written: list[tuple[str, int, list[Any]]] = []
        self.told: list[str] = []
        self._answers: list[dict[str, Any]] = []
        self._answered = threading.Semaphore(0)
        self._other: list[str] = []
        command = Command(sys.executable, "ua_demo.simulators.modbus", True, list(options))
        self._process = ForkedProcess(
            command, system.clean_environment(PYTHONPATH=str(system.ROOT / "demo")), reads=True
        )
        self._reader = threading.Thread(target=self._read, name="plc-reader", daemon=True)
        self._reader.start()
        self._wait("the PLC's start")

    def _read(self) -> None:
        for line in self._process.stdout:
            if line.startswith("told: "):
                self.told.append(line.removeprefix("told: ").rstrip("\n"))
            elif not line.startswith("{"):
                self._other.append(line)
            elif "written" in (said := json.loads(line)):
                self.written.append(tuple(said["written"]))
            else:
                self._answers.append(said)
                self._answered.release()

    def _wait(self, what: str) -> dict[str, Any]:
        if not self._answered.acquire(timeout=WAIT_S):
            raise AssertionError(f"{what} took more than {WAIT_S:g} s:\n{''.join(self._other)}")
        return self._answers[-1]

    def do(self, command: str, **rest: Any) -> dict[str, Any]:
        """Give a command, and wait for its answer."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"do": command, **rest}) + "\n")
        self._process.stdin.flush()
        return self._wait(f"the PLC's {command}")

    def end(self) -> None:
        """End the process, which its end of input asks for."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(5)
        self._process.stdout.close()


PLACES: Final[dict[Topic, tuple[str, int, int]]] = {
    Topic(SPACE, 2, 11): ("float64", 400, 0),
    Topic(SPACE, 2, 12): ("string", 410, 10),
    Topic(SPACE, 2, 13): ("float64", 420, 0),
}
TAKEN: Final = {Topic(OTHER_SPACE, 2, 1001): (500, 4), Topic(OTHER_SPACE, 2, 1002): (504, 24)}


class PlcRobot:
    """See MappedRobot."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._rubbish: Rubbish | None = None
        self.plc = PlcProcess("--port", str(port), "--tell-writes")

    def show(self, topic: Topic, values: Sequence[Any]) -> None:
        """See MappedRobot. Each reading of the driver sees it."""
        kind, address, length = PLACES[topic]
        what = {"table": "holding", "address": address, "type": kind, "length": length, "values": list(values)}
        self.plc.do("put", **what, until_read_s=1.0)

    def taken(self, topic: Topic) -> list[tuple[Any, ...]]:
        """See MappedRobot."""
        address, words = TAKEN[topic]
        return [
            struct.unpack(f">{words // 4}d", struct.pack(f">{words}H", *cells))
            for table, first, cells in list(self.plc.written)
            if (table, first, len(cells)) == ("holding", address, words)
        ]

    def leave(self) -> None:
        """See MappedRobot."""
        self.plc.do("hang up")

    def come_back(self) -> None:
        """See MappedRobot."""
        self.plc.do("listen")

    def misbehave(self) -> None:
        """See MappedRobot."""
        self.leave()
        self._rubbish = Rubbish("127.0.0.1", self._port, b"\x00\x01\x00\x00\x00\xff\x01\x03")

    def behave(self) -> None:
        """See MappedRobot."""
        assert self._rubbish is not None
        self._rubbish.end()
        self.come_back()


class PlcSpace:
    """See MappedSpace and SkilledSpace."""

    remembers = True

    number = SPACE
    own_work = "ua_bridges.modbus.device.Device._turn"
    sources: Final[dict[Topic, Kind]] = dict(zip(PLACES, (NUMBER, TEXT, TWIST), strict=True))
    sinks: Final[dict[Topic, Kind]] = dict(zip(TAKEN, (NUMBER, TWIST), strict=True))
    is_sampled = True

    def __init__(self, folder: Path) -> None:
        self._folder, self._port = folder, system.free_tcp_port()
        self._robot: PlcRobot | None = None
        content = FLEET.format(port=self._port).encode()
        self._config: FleetConfig = load_content(content, "fleet.yaml", {})

    @property
    def robot(self) -> PlcRobot:
        """See MappedSpace."""
        assert self._robot is not None
        return self._robot

    def make_driver(self) -> Driver:
        """See MappedSpace."""
        driver = create_driver(self._config, "plc")
        driver.remember_in(self._folder)
        return driver

    def appear(self) -> None:
        """See MappedSpace."""
        self._robot = PlcRobot(self._port)

    def told(self) -> list[str]:
        """See SkilledSpace."""
        return self.robot.plc.told

    def freeze(self) -> None:
        """See SkilledSpace: the PLC answers, and its program stands."""
        self.robot.plc.do("stop")

    def cut(self) -> None:
        """See SkilledSpace."""
        self.robot.leave()

    def end(self) -> None:
        """End the PLC."""
        if self._robot is not None:
            self._robot.plc.end()


@asynccontextmanager
async def open_mapped_space(folder: Path, processes: system.Processes) -> AsyncGenerator[PlcSpace]:
    """A PLC that no other test uses."""
    space = PlcSpace(folder)
    try:
        yield space
    finally:
        space.end()


@asynccontextmanager
async def open_skilled_space(folder: Path, processes: system.Processes) -> AsyncGenerator[PlcSpace]:
    """The same; its program does the skill."""
    async with open_mapped_space(folder, processes) as space:
        space.appear()
        yield space
