"""A ROS 1 graph for the contract suite: a real master, the real driver here, and a stock rospy node elsewhere."""

from __future__ import annotations

import signal
import time
import xmlrpc.client
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from ua_bridges.ros.delivered import STATE_VARIABLE
from ua_bridges.ros1.config import Ros1BridgeConfig
from ua_bridges.ros1.driver import create_driver

from tests import system
from tests.contract.harness import TWIST, WORK, WORK_ID, RobotProcess, driven_fleet
from ua_fleet.bridge import Driver
from ua_fleet.config.schema import FleetConfig, PubSubConfig, PubSubSecurity
from ua_fleet.topics import Topic

NEEDS = ("ros1",)
# rospy calls functions of the standard library that Python 3.11 calls deprecated.
WARNINGS: tuple[str, ...] = (
    "ignore:notifyAll:DeprecationWarning",  # rospy, in threads of its own
    "ignore:unclosed <socket:ResourceWarning",  # rospy leaves the sockets of its XML-RPC calls to the collector
)

ROBOT = Path(__file__).parent / "robots" / "ros1_robot.py"
SKILLED_ROBOT = ROBOT.with_name("ros1_skilled.py")


class Master:
    """A rosmaster that is not up yet."""

    def __init__(self, folder: Path, processes: system.Processes) -> None:
        self._processes, self._port = processes, system.free_tcp_port()
        self.uri = f"http://127.0.0.1:{self._port}"
        self.env = system.clean_environment(
            ROS_MASTER_URI=self.uri, ROS_IP="127.0.0.1", ROS_LOG_DIR=str(folder / "log"), HOME=str(folder)
        )

    def appear(self) -> None:
        """Start it; ready when it answers."""
        self._processes.start("/usr/bin/rosmaster", "--core", "-p", str(self._port), "-w", "3", env=self.env)
        deadline = time.monotonic() + 20
        while True:
            try:
                with xmlrpc.client.ServerProxy(self.uri) as master:
                    master.getPid("/test")
                break
            except OSError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.02)


class Ros1Space:
    """See Space."""

    number = 1
    can_be_absent = True
    own_work = "ua_bridges.ros1.watch.Watch._look"

    def __init__(self, folder: Path, processes: system.Processes) -> None:
        self._master = Master(folder, processes)
        self._robot: RobotProcess | None = None
        self._config = FleetConfig(
            version=1,
            pubsub=PubSubConfig(security=PubSubSecurity.NONE),
            bridges={"arm": Ros1BridgeConfig(kind="ros1", master_uri=self._master.uri)},
        )

    @property
    def robot(self) -> RobotProcess:
        """See Space."""
        assert self._robot is not None
        return self._robot

    def make_driver(self) -> Driver:
        """See Space."""
        return create_driver(self._config, "arm")

    def appear(self) -> None:
        """See Space."""
        self._master.appear()
        self._robot = RobotProcess([system.ROS1_PYTHON, "-u", ROBOT], self._master.env)

    def end(self) -> None:
        """End the robot."""
        if self._robot is not None:
            self._robot.end()


@asynccontextmanager
async def open_space(folder: Path, processes: system.Processes) -> AsyncGenerator[Ros1Space]:
    """A graph of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(STATE_VARIABLE, str(folder))
        space = Ros1Space(folder, processes)
        try:
            yield space
        finally:
            space.end()


class DrivenRos1Space(Ros1Space):
    """See DrivenSpace."""

    topic = Topic(0, 2, 1905)

    def __init__(self, folder: Path, processes: system.Processes) -> None:
        super().__init__(folder, processes)
        self._config = driven_fleet("arm", {"kind": "ros1", "master_uri": self._master.uri})

    def listen(self) -> None:
        """See DrivenSpace."""
        self.robot.subscribe("cmd_vel", TWIST)

    def heard(self) -> list[tuple[float, float]]:
        """See DrivenSpace."""
        return [(values["linear.x"], values["angular.z"]) for values in self.robot.heard("cmd_vel")]


@asynccontextmanager
async def open_driven_space(folder: Path, processes: system.Processes) -> AsyncGenerator[DrivenRos1Space]:
    """A graph of its own, with a robot in it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(STATE_VARIABLE, str(folder))
        space = DrivenRos1Space(folder, processes)
        space.appear()
        try:
            yield space
        finally:
            space.end()


class SkilledRos1Space:
    """See SkilledSpace."""

    remembers = True

    def __init__(self, master: Master, robot: system.Child) -> None:
        self._robot = robot
        self._config = FleetConfig.model_validate(
            {
                "version": 1,
                "pubsub": {"security": "none"},
                "bridges": {"arm": Ros1BridgeConfig(kind="ros1", master_uri=master.uri)},
                "robots": {"machine": {"bridge": "arm", "skill_status_id": 1902, "skills": {"work": WORK}}},
            }
        )

    def make_driver(self) -> Driver:
        """See SkilledSpace."""
        return create_driver(self._config, "arm")

    def told(self) -> list[str]:
        """See SkilledSpace."""
        return [line.removeprefix("told: ") for line in self._robot.lines if line.startswith("told: ")]

    def freeze(self) -> None:
        """See SkilledSpace."""
        self._robot.freeze()

    def cut(self) -> None:
        """See SkilledSpace: a graph has no link that breaks alone."""
        self._robot.end(signal.SIGKILL)


@asynccontextmanager
async def open_skilled_space(folder: Path, processes: system.Processes) -> AsyncGenerator[SkilledRos1Space]:
    """A graph of its own, with a robot whose own program has the skill."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(STATE_VARIABLE, str(folder))
        master = Master(folder, processes)
        master.appear()
        robot = processes.start(system.ROS1_PYTHON, "-u", SKILLED_ROBOT, str(WORK_ID), env=master.env)
        robot.wait_for("ready")
        yield SkilledRos1Space(master, robot)
