"""A bridge and a robot that records what reaches it, each a process, in ROS 1 or ROS 2."""

from __future__ import annotations

import asyncio
import json
import os
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from ua_bridges.ros2.environment import PROFILES_VARIABLE, profile_path

from tests import system
from tests.contract.ros1 import Master
from tests.integration.teleoperation.driving import WAIT_S
from ua_fleet.config.load import load
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.wire.security import SecurityPolicy

NODES = Path(__file__).parent / "nodes"
PROGRAM = Path(__file__).parents[1] / "run_bridge.py"
DEADMAN_S, ROBOT_TIMEOUT_S, PERIOD_S = 0.3, 0.4, 0.02
SPEED, STOP_S = 0.5, 0.5 / 2.0 + 1.0 / 20.0 + 2.0 / 20.0
"""Of the linear axis; see `CARRIER`."""

CARRIER: dict[str, Any] = {
    "skill_status_id": 1009,
    "data": {
        "cmd_vel": {
            "id": 1002,
            "origin": "server",
            "fields": {
                "linear": {"type": "Double", "path": "linear.x"},
                "angular": {"type": "Double", "path": "angular.z"},
            },
            "sink": {"topic": "/cmd_vel", "type": "geometry_msgs/Twist"},
        }
    },
    "skills": {"wave": {"id": 1010, "arguments": {"seconds": {"type": "Double"}}}},
    "teleoperation": {
        "id": 1003,
        "acquire_id": 1004,
        "renew_id": 1005,
        "release_id": 1006,
        "data": "cmd_vel",
        "axes": {
            "linear": {"speed": SPEED, "acceleration": 1.0, "deceleration": 2.0, "jerk": 20.0},
            "angular": {"speed": 1.0, "acceleration": 4.0, "jerk": 40.0},
        },
        "deadman_ms": round(DEADMAN_S * 1000),
        "robot_timeout_ms": round(ROBOT_TIMEOUT_S * 1000),
        "period_ms": round(PERIOD_S * 1000),
    },
}


class Speed(NamedTuple):
    """What reached the robot, and when by the clock of all processes here."""

    at: float
    linear: float
    angular: float


class Hall:
    """A fleet of one bridge with one robot."""

    def __init__(
        self, kind: str, space: int, folder: Path, url: str, processes: system.Processes, master: Master | None
    ):
        self.kind, self.space, self.folder = kind, space, folder
        self._url, self._processes, self._master = url, processes, master
        self.robot: system.Child
        self.bridge: system.Child
        self._robot_timeout_s = ROBOT_TIMEOUT_S
        self._recorded: dict[str, list[Speed]] = {}
        self._lines_read = 0

    def fleet(
        self,
        *,
        server: Mapping[str, Any] | None = None,
        deadman_s: float = DEADMAN_S,
        robot_timeout_s: float = ROBOT_TIMEOUT_S,
        **pubsub: Any,
    ) -> FleetConfig:
        """Write the fleet's file, and keys where it has some; before the robot starts, whose own watch this is, too."""
        self._robot_timeout_s = robot_timeout_s
        teleoperation = {
            **CARRIER["teleoperation"],
            "deadman_ms": round(deadman_s * 1000),
            "robot_timeout_ms": round(robot_timeout_s * 1000),
        }
        bridge: dict[str, Any] = {"kind": self.kind, "space": self.space, "status_id": 1001}
        if self._master is not None:
            bridge["master_uri"] = self._master.uri
        raw = {
            "version": 1,
            "pubsub": {"security": "none", "url": self._url, "interface": "lo", **pubsub},
            "bridges": {"floor": bridge},
            "robots": {"carrier": {"bridge": "floor", **CARRIER, "teleoperation": teleoperation}},
            "server": dict(server or {}),
        }
        path = self.folder / "fleet.json"
        path.write_text(json.dumps(raw))
        config = load(path, {})
        if "security" in pubsub:
            keys = KeyFolder(self.folder / "keys")
            for group_id in all_groups(config):
                keys.write(KeyFile.new(group_id, SecurityPolicy.AES256_CTR, 3600.0, time.time()))
        return config

    def start_robot(self) -> system.Child:
        """Start the robot."""
        if self._master is not None:
            env = self._master.env | {"PYTHONPATH": "bridges"}
            command = [str(system.ROS1_PYTHON), "-u", str(NODES / "carrier_ros1.py"), str(self._robot_timeout_s)]
        else:
            env = system.clean_environment(
                ROS_DOMAIN_ID=str(self.space), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", PYTHONPATH="bridges"
            )
            env[PROFILES_VARIABLE] = str(profile_path("robot"))
            command = [
                sys.executable,
                "-u",
                str(NODES / "carrier_ros2.py"),
                str(self.space),
                str(self._robot_timeout_s),
            ]
        self.robot = self._processes.start(*command, env=env)
        self._recorded, self._lines_read = {"heard": [], "moved": []}, 0
        self.robot.wait_for("ready")
        return self.robot

    def start_bridge(self) -> system.Child:
        """Start the bridge."""
        self.bridge = self.start_bridge_in(self.folder)
        return self.bridge

    def start_bridge_in(self, folder: Path) -> system.Child:
        """Start a process of the bridge that has its file and its state in a folder."""
        if self._master is not None:
            env, python = self._master.env, str(system.ROS1_PYTHON)
        else:
            env = system.clean_environment(PYTHONPATH=os.pathsep.join(("bridges", ".")))
            env.pop(PROFILES_VARIABLE, None)
            python = sys.executable
        env = env | {"UA_FLEET_RUNTIME_DIR": str(folder), "PYTHONUNBUFFERED": "1"}
        bridge = self._processes.start(python, str(PROGRAM), str(folder / "fleet.json"), "floor", env=env)
        bridge.wait_for("ready")
        return bridge

    def speeds(self, what: str = "moved", since: float = 0.0) -> list[Speed]:
        """What the robot recorded: `heard` on its topic, or what it `moved` by after its own watch."""
        new = self.robot.lines[self._lines_read :]  # who waits asks a hundred times a second
        self._lines_read += len(new)
        for parts in map(str.split, new):
            if parts and parts[0] in self._recorded:
                self._recorded[parts[0]].append(Speed(*map(float, parts[1:])))
        return [speed for speed in self._recorded[what] if speed.at >= since]

    async def until(self, is_so: Callable[[list[Speed]], bool], what: str = "moved") -> list[Speed]:
        """Wait for what the robot records."""
        async with asyncio.timeout(WAIT_S):
            while not is_so(speeds := self.speeds(what)):
                await asyncio.sleep(0.01)
        return speeds


ROS1, ROS2 = (pytest.param(kind, marks=pytest.mark.needs(kind)) for kind in ("ros1", "ros2"))
BOTH = pytest.mark.parametrize("hall", [ROS1, ROS2], indirect=True)
"""For what the two do each in its own way; the rest is the kit's."""


@pytest.fixture(params=[ROS2])
def hall(request: pytest.FixtureRequest, tmp_path: Path, udp_url: str, processes: system.Processes) -> Hall:
    """Nothing is started yet but a ROS master."""
    if request.param == "ros2":
        domain: int = request.getfixturevalue("ros_domain")
        return Hall("ros2", domain, tmp_path, udp_url, processes, None)
    master = Master(tmp_path, processes)
    master.appear()
    return Hall("ros1", 1, tmp_path, udp_url, processes, master)
