"""A Universal Robots controller for the contract suite: ur-rtde here, and a simulated controller in its own process.

Its own skills are no strings and numbers that come back, so `test_skills.py` does not fit; `tests/integration/ur` has
the same questions for moves, scripts and the dashboard server.
"""

from __future__ import annotations

from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

from ua_bridges.ur.driver import create_driver

from tests.contract.harness import NUMBER, TWIST, Kind, Rubbish
from tests.system import Processes
from tests.ur_controller import UrController
from ua_fleet.bridge import Driver
from ua_fleet.config.load import load_content
from ua_fleet.topics import SERVER_SPACE, Topic

NEEDS = ("ur",)
WARNINGS: tuple[str, ...] = ()

SPACE: Final = 300
FLEET: Final = """
version: 1
pubsub: {{security: none}}
bridges:
  arm: {{kind: ur, space: 300, status_id: 1, address: {host}, retry_s: [0.05, 0.2], answer_timeout_s: 2.0}}
robots:
  ur5:
    bridge: arm
    data:
      number:
        {{id: 11, type: Double, path: output_double_register_12, source: {{max_rate_hz: 500, only_changes: true}}}}
      twist:
        id: 12
        fields:
          linear.x: {{type: Double, path: output_double_register_13}}
          linear.y: {{type: Double, path: output_double_register_14}}
          linear.z: {{type: Double, path: output_double_register_15}}
          angular.x: {{type: Double, path: output_double_register_16}}
          angular.y: {{type: Double, path: output_double_register_17}}
          angular.z: {{type: Double, path: output_double_register_18}}
        source: {{max_rate_hz: 500, only_changes: true}}
      taken: {{id: 13, type: Double, origin: server, sink: {{output: 'input_double_register[18]'}}}}
"""
REGISTERS: Final = {Topic(SPACE, 2, 11): 12, Topic(SPACE, 2, 12): 13}
TAKEN: Final = Topic(SERVER_SPACE, 2, 13)
INPUT: Final = "input_double_register_18"


class UrRobot:
    """See MappedRobot."""

    def __init__(self, controller: UrController) -> None:
        self._controller = controller
        self._rubbish: Rubbish | None = None
        self.come_back()

    def show(self, topic: Topic, values: Sequence[Any]) -> None:
        """See MappedRobot."""
        self._controller.do("output_registers", first=REGISTERS[topic], values=list(values))

    def taken(self, topic: Topic) -> list[tuple[Any, ...]]:
        """See MappedRobot."""
        assert topic == TAKEN
        return [(value,) for value in self._controller.do("recorded", input=INPUT)["recorded"]]

    def leave(self) -> None:
        """See MappedRobot."""
        self._controller.end()

    def come_back(self) -> None:
        """See MappedRobot."""
        self._controller.start()
        self._controller.do("record", input=INPUT)

    def misbehave(self) -> None:
        """See MappedRobot."""
        self.leave()
        self._rubbish = Rubbish(self._controller.host, 30004, b"\0")

    def behave(self) -> None:
        """See MappedRobot."""
        assert self._rubbish is not None
        self._rubbish.end()
        self.come_back()


class UrSpace:
    """See MappedSpace."""

    number = SPACE
    own_work = "ua_bridges.ur.telemetry.Telemetry.sampled"
    sources: Final[dict[Topic, Kind]] = dict(zip(REGISTERS, (NUMBER, TWIST), strict=True))
    sinks: Final[dict[Topic, Kind]] = {TAKEN: NUMBER}
    is_sampled = True
    """ur-rtde keeps the last of the controller's samples; what was replaced unseen is counted."""

    def __init__(self, processes: Processes) -> None:
        self._controller = UrController(processes)
        self._config = load_content(FLEET.format(host=self._controller.host).encode(), "fleet.yaml", {})
        self._robot: UrRobot | None = None

    @property
    def robot(self) -> UrRobot:
        """See MappedSpace."""
        assert self._robot is not None
        return self._robot

    def make_driver(self) -> Driver:
        """See MappedSpace."""
        return create_driver(self._config, "arm")

    def appear(self) -> None:
        """See MappedSpace."""
        self._robot = UrRobot(self._controller)


@asynccontextmanager
async def open_mapped_space(folder: Path, processes: Processes) -> AsyncGenerator[UrSpace]:
    """A controller that no other test uses."""
    yield UrSpace(processes)
