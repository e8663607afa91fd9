"""A device on a serial port for the contract suite: the real driver, and the terminal of a pty."""

from __future__ import annotations

import shlex
import threading
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

from ua_bridges.plugged.driver import create_driver

from tests import system
from tests.contract.harness import NUMBER, TEXT, TWIST, Kind
from tests.plugged_device import PtyDevice
from ua_fleet.bridge import Driver
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig
from ua_fleet.topics import SERVER_SPACE, Topic

NEEDS: tuple[str, ...] = ()
WARNINGS: tuple[str, ...] = ()

SPACE: Final = 300
FLEET: Final = r"""
version: 1
pubsub: {security: none}
bridges:
  pc: {kind: plugged, space: 300, status_id: 1, devices: {box: {path: PATH}}}
robots:
  machine:
    bridge: pc
    skill_status_id: 1902
    data:
      number: {id: 11, type: Double, source: {device: box, line: "N {value}", when: always}}
      text: {id: 12, type: String, source: {device: box, line: "S {value}", when: always}}
      pose:
        id: 13
        fields:
          linear.x: {type: Double}
          linear.y: {type: Double}
          linear.z: {type: Double}
          angular.x: {type: Double}
          angular.y: {type: Double}
          angular.z: {type: Double}
        source:
          device: box
          line: "P {linear.x} {linear.y} {linear.z} {angular.x} {angular.y} {angular.z}"
          when: always
      speed: {id: 14, type: Double, origin: server, sink: {device: box, command: "SPEED {value}\n"}}
      goal:
        id: 15
        origin: server
        fields:
          linear.x: {type: Double}
          linear.y: {type: Double}
          linear.z: {type: Double}
          angular.x: {type: Double}
          angular.y: {type: Double}
          angular.z: {type: Double}
        sink:
          device: box
          command: "GOAL {linear.x} {linear.y} {linear.z} {angular.x} {angular.y} {angular.z}\n"
    skills:
      work:
        id: 1900
        arguments: {work: {type: String}, seconds: {type: Double}}
        results: {done: {type: String}, seconds: {type: Double}}
        timeout_s: 20.0
        via:
          device: box
          command: "WORK {work} {seconds}\n"
          done: "DONE {done} {seconds}"
          failed: "ERR {message}"
          halt: "HALT\n"
          halted: "STOPPED"
"""
SAID: Final = {Topic(SPACE, 2, 11): "N", Topic(SPACE, 2, 12): "S", Topic(SPACE, 2, 13): "P"}
TAKEN: Final = {Topic(SERVER_SPACE, 2, 14): "SPEED", Topic(SERVER_SPACE, 2, 15): "GOAL"}


class Box:
    """See MappedRobot: a device whose firmware works, and says and takes values."""

    def __init__(self, path: Path) -> None:
        self.device = PtyDevice(path, self._obey)
        self.told: list[str] = []
        self.is_stubborn = False
        """Whether it hears what would halt it, and goes on."""
        self._said_enough = threading.Event()

    def _obey(self, device: PtyDevice, line: str) -> None:
        if line == "HALT" and not self.is_stubborn:
            device.say("STOPPED\n")
        if not line.startswith("WORK"):
            return
        _, work, seconds = shlex.split(line)
        if work == "refuse":
            device.say("ERR the machine does not do that\n")
            return
        self.told.append(work)
        if work == "fail":
            device.say("ERR the machine broke\n")
        elif work != "never ends":
            done = f'DONE "{work}" {seconds}\n'
            threading.Timer(float(seconds), device.say, (done,)).start()

    def show(self, topic: Topic, values: Sequence[Any]) -> None:
        """See MappedRobot."""
        self.device.wait_for_reader()
        self.device.say(f"{SAID[topic]} {' '.join(map(str, values))}\n")

    def taken(self, topic: Topic) -> list[tuple[Any, ...]]:
        """See MappedRobot."""
        lines = [line.split() for line in list(self.device.heard)]
        return [tuple([float(word) for word in words[1:]]) for words in lines if words[0] == TAKEN[topic]]

    def leave(self) -> None:
        """See MappedRobot."""
        self.device.unplug()

    def misbehave(self) -> None:
        """See MappedRobot."""
        self._said_enough.clear()
        threading.Thread(target=self._say_rubbish, daemon=True).start()

    def _say_rubbish(self) -> None:
        while not self._said_enough.wait(0.01):
            self.device.write(b"x" * 1000)

    def behave(self) -> None:
        """See MappedRobot."""
        self._said_enough.set()

    def come_back(self) -> None:
        """See MappedRobot."""
        self.device.plug()


class PluggedSpace:
    """See MappedSpace and SkilledSpace."""

    number = SPACE
    own_work = "ua_bridges.plugged.sensor.Sensor.turn"
    remembers = False
    sources: Final[dict[Topic, Kind]] = dict(zip(SAID, (NUMBER, TEXT, TWIST), strict=True))
    sinks: Final[dict[Topic, Kind]] = dict(zip(TAKEN, (NUMBER, TWIST), strict=True))
    is_sampled = False

    def __init__(self, folder: Path) -> None:
        self.robot = Box(folder / "box")
        content = FLEET.replace("PATH", str(folder / "box")).encode()
        self._config: FleetConfig = load_content(content, "fleet.yaml", {})

    def make_driver(self) -> Driver:
        """See MappedSpace."""
        return create_driver(self._config, "pc")

    def appear(self) -> None:
        """See MappedSpace."""
        self.robot.device.plug()

    def told(self) -> list[str]:
        """See SkilledSpace."""
        return self.robot.told

    def freeze(self) -> None:
        """See SkilledSpace."""
        self.robot.is_stubborn = True

    def cut(self) -> None:
        """See SkilledSpace."""
        self.robot.leave()


@asynccontextmanager
async def open_mapped_space(folder: Path, processes: system.Processes) -> AsyncGenerator[PluggedSpace]:
    """A device that is not plugged in yet."""
    space = PluggedSpace(folder)
    try:
        yield space
    finally:
        space.robot.leave()


@asynccontextmanager
async def open_skilled_space(folder: Path, processes: system.Processes) -> AsyncGenerator[PluggedSpace]:
    """The same, plugged in; its firmware does the skill."""
    async with open_mapped_space(folder, processes) as space:
        space.appear()
        yield space
