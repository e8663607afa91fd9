from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Literal

import pytest
from ua_bridges.ros2.config import Ros2BridgeConfig
from ua_bridges.ros2.environment import PROFILES_VARIABLE, profile_path

from tests.system import Child, Processes, clean_environment

NODES = Path(__file__).parent / "nodes"
STATUS_ID = 1900


class Ros2Space:
    """A ROS 2 domain with a bridge and stock nodes, each a process."""

    def __init__(self, domain: int, udp_url: str, folder: Path, processes: Processes) -> None:
        self.domain, self.udp_url, self.folder = domain, udp_url, folder
        self._processes = processes
        self.packages: list[str] = []
        """Folders with message packages that are not installed."""
        self._bridge: Child | None = None

    def environment(self, **extra: str) -> dict[str, str]:
        return clean_environment(
            ROS_DOMAIN_ID=str(self.domain),
            ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
            PYTHONUNBUFFERED="1",
            PYTHONPATH=os.pathsep.join(("bridges", *self.packages)),
            **extra,
        )

    def fleet(self, robots: dict[str, Any] | None = None, **pubsub: Any) -> dict[str, Any]:
        """A fleet with one bridge named `mobile`."""
        return {
            "version": 1,
            "pubsub": {"security": "none", "url": self.udp_url, "interface": "lo", **pubsub},
            "bridges": {"mobile": {"kind": "ros2", "space": self.domain, "status_id": STATUS_ID}},
            "robots": robots or {},
        }

    def bridge(
        self,
        robots: dict[str, Any] | None = None,
        *,
        wait: bool = True,
        profile: Literal["robot"] | None = None,
        scenarios: dict[str, Any] | None = None,
        **pubsub: Any,
    ) -> Child:
        """Start a bridge named `mobile`."""
        config = {**self.fleet(robots, **pubsub), "scenarios": scenarios or {}}
        path = self.folder / "fleet.json"
        path.write_text(json.dumps(config))
        program = Path(__file__).parent.parent / "run_bridge.py"
        environment = clean_environment(
            PYTHONUNBUFFERED="1",
            PYTHONPATH=os.pathsep.join(("bridges", ".", *self.packages)),
            UA_FLEET_RUNTIME_DIR=str(self.folder),
        )
        environment.pop(PROFILES_VARIABLE, None)
        if profile is not None:
            environment[PROFILES_VARIABLE] = str(profile_path(profile))
        self._bridge = self._processes.start(sys.executable, program, path, "mobile", env=environment)
        if wait:
            self._bridge.wait_for("ready")
        return self._bridge

    def node(self, program: str, *args: object, quick: bool = True) -> Child:
        """Start a stock node; `quick` with the robots' Fast DDS profile."""
        profile = {PROFILES_VARIABLE: str(profile_path("robot"))} if quick else {}
        command = [str(arg) for arg in args]
        child = self._processes.start(sys.executable, NODES / program, *command, env=self.environment(**profile))
        child.wait_for("ready")
        time.sleep(0.3)  # the bridge finds the node
        return child

    def talker(self, topic: str, kind: str, values: Any, *options: object, quick: bool = True) -> Child:
        return self.node(
            "talker.py", topic, kind, json.dumps(values).replace('"COUNT"', "COUNT"), *options, quick=quick
        )

    def listener(self, topic: str, kind: str, *options: object, quick: bool = True) -> Child:
        is_there = self._bridge is not None and self._bridge.process.poll() is None
        meet = ("--meet", Ros2BridgeConfig.model_fields["node_name"].default) if is_there else ()
        return self.node("listener.py", topic, kind, *options, *meet, quick=quick)


@pytest.fixture(scope="session")
def robot_msgs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package `robot_msgs`, which has an action type."""
    folder = tmp_path_factory.mktemp("robot_msgs")
    program = Path(__file__).parent / "interfaces.py"
    run = subprocess.run([sys.executable, program, folder], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return folder


@pytest.fixture
def ros2(request: pytest.FixtureRequest, udp_url: str, tmp_path: Path, processes: Processes) -> Ros2Space:
    domain: int = request.getfixturevalue("ros_domain")
    return Ros2Space(domain, udp_url, tmp_path, processes)


def heard(child: Child) -> list[str]:
    """What a listener has printed so far."""
    return [line.removeprefix("heard: ") for line in child.lines if line.startswith("heard: ")]
