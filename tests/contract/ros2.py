"""A ROS 2 domain for the contract suite: the real driver here, and a stock rclpy node in a process of its own."""

from __future__ import annotations

import signal
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from ua_bridges.ros.delivered import STATE_VARIABLE
from ua_bridges.ros2.config import Ros2BridgeConfig
from ua_bridges.ros2.driver import create_driver
from ua_bridges.ros2.environment import PROFILES_VARIABLE, profile_path

from tests import system
from tests.contract.harness import TWIST, WORK, WORK_ID, RobotProcess, driven_fleet
from ua_fleet.bridge import Driver
from ua_fleet.config.schema import FleetConfig, PubSubConfig, PubSubSecurity
from ua_fleet.topics import Topic

NEEDS = ("ros2",)
# rclpy's type support imports lark, which imports a deprecated module of the standard library.
WARNINGS = ("ignore:module 'sre_:DeprecationWarning",)

ROBOT = Path(__file__).parent / "robots" / "ros2_robot.py"
SKILLED_ROBOT = ROBOT.with_name("ros2_skilled.py")


class Ros2Space:
    """See Space."""

    can_be_absent = False
    own_work = "ua_bridges.ros2.watch.Watch.turn"

    def __init__(self, domain: int) -> None:
        self.number = domain
        self._robot: RobotProcess | None = None
        self._config = FleetConfig(
            version=1,
            pubsub=PubSubConfig(security=PubSubSecurity.NONE),
            bridges={"mobile": Ros2BridgeConfig(kind="ros2", space=domain)},
        )

    @property
    def robot(self) -> RobotProcess:
        """See Space."""
        assert self._robot is not None
        return self._robot

    def make_driver(self) -> Driver:
        """See Space."""
        return create_driver(self._config, "mobile")

    def appear(self) -> None:
        """See Space."""
        env = system.clean_environment(ROS_DOMAIN_ID=str(self.number), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
        env[PROFILES_VARIABLE] = str(profile_path("robot"))
        self._robot = RobotProcess([sys.executable, "-u", ROBOT], env)

    def end(self) -> None:
        """End the robot."""
        if self._robot is not None:
            self._robot.end()


@asynccontextmanager
async def open_space(folder: Path, processes: system.Processes) -> AsyncGenerator[Ros2Space]:
    """A domain that no other test uses."""
    with system.ros_domain() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv(STATE_VARIABLE, str(folder))
        space = Ros2Space(domain)
        try:
            yield space
        finally:
            space.end()


class DrivenRos2Space(Ros2Space):
    """See DrivenSpace."""

    topic = Topic(0, 2, 1905)

    def __init__(self, domain: int) -> None:
        super().__init__(domain)
        self._config = driven_fleet("mobile", {"kind": "ros2", "space": domain})

    def listen(self) -> None:
        """See DrivenSpace."""
        self.robot.subscribe("cmd_vel", TWIST)

    def heard(self) -> list[tuple[float, float]]:
        """See DrivenSpace."""
        return [(values["linear.x"], values["angular.z"]) for values in self.robot.heard("cmd_vel")]


@asynccontextmanager
async def open_driven_space(folder: Path, processes: system.Processes) -> AsyncGenerator[DrivenRos2Space]:
    """A domain that no other test uses, with a robot in it."""
    with system.ros_domain() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv(STATE_VARIABLE, str(folder))
        space = DrivenRos2Space(domain)
        space.appear()
        try:
            yield space
        finally:
            space.end()


class SkilledRos2Space:
    """See SkilledSpace."""

    remembers = True

    def __init__(self, domain: int, robot: system.Child) -> None:
        self._robot = robot
        robots = {"machine": {"bridge": "mobile", "skill_status_id": 1902, "skills": {"work": WORK}}}
        self._config = FleetConfig.model_validate(
            {
                "version": 1,
                "pubsub": {"security": "none"},
                "bridges": {"mobile": Ros2BridgeConfig(kind="ros2", space=domain)},
                "robots": robots,
            }
        )

    def make_driver(self) -> Driver:
        """See SkilledSpace."""
        return create_driver(self._config, "mobile")

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
async def open_skilled_space(folder: Path, processes: system.Processes) -> AsyncGenerator[SkilledRos2Space]:
    """A domain that no other test uses, with a robot whose own program has the skill."""
    with system.ros_domain() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv(STATE_VARIABLE, str(folder))
        env = system.clean_environment(
            ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", PYTHONPATH="bridges"
        )
        env[PROFILES_VARIABLE] = str(profile_path("robot"))
        robot = processes.start(sys.executable, "-u", SKILLED_ROBOT, str(domain), str(WORK_ID), env=env)
        robot.wait_for("ready")
        yield SkilledRos2Space(domain, robot)
