"""A robot of a demonstration is driven by hand behind its own bridge, as its `fleet.yaml` has it."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from ua_bridges.ros2.environment import PROFILES_VARIABLE, profile_path
from ua_demo.site import Site
from ua_demo.talkrobots import robots
from ua_demo.talkrobots.setting import make_setting

from tests import system
from tests.integration.teleoperation.conftest import PROGRAM
from tests.integration.teleoperation.driving import WAIT_S, driving
from ua_fleet.config.load import load
from ua_fleet.config.schema import FleetConfig
from ua_fleet.topics import Topic


def only(folder: Path, robot: str, domain: int, url: str) -> FleetConfig:
    """The fleet of the nine tasks, without all but one robot."""
    site = Site(folder, 4840, (url,), "secret", 11311, None, "as asked", False)
    make_setting(site, domains=range(21, 24), speed=1.0, mode="operator", say=lambda _line: None)
    raw: dict[str, Any] = yaml.safe_load(site.config_file.read_text(encoding="utf-8"))
    bridge = raw["robots"][robot]["bridge"]
    alone = {
        "version": 1,
        "pubsub": raw["pubsub"],
        "bridges": {bridge: {**raw["bridges"][bridge], "space": domain}},
        "robots": {robot: raw["robots"][robot]},
    }
    path = folder / "alone.json"
    path.write_text(json.dumps(alone), encoding="utf-8")
    return load(path, {})


@pytest.mark.needs("ros2")
async def test_a_pioneer_goes_where_it_is_driven(
    tmp_path: Path, udp_url: str, ros_domain: int, processes: system.Processes
) -> None:
    config = only(tmp_path, "pioneer_1", ros_domain, udp_url)
    in_ros = system.clean_environment(
        ROS_DOMAIN_ID=str(ros_domain),
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
        PYTHONPATH=os.pathsep.join(("bridges", "demo", ".")),
    )
    in_ros[PROFILES_VARIABLE] = str(profile_path("robot"))
    program = Path(robots.__file__).parent / "pioneer.py"
    where = ("--name", "pioneer_1", "--space", str(ros_domain), "--go-id", "1210", "--at", "2", "1")
    processes.start(sys.executable, "-u", program, *where, env=in_ros).wait_for("is ready")
    in_bridge = system.clean_environment(
        PYTHONPATH=os.pathsep.join(("bridges", "demo", ".")), UA_FLEET_RUNTIME_DIR=str(tmp_path), PYTHONUNBUFFERED="1"
    )
    bridge = processes.start(sys.executable, PROGRAM, tmp_path / "alone.json", "pioneer_1_bridge", env=in_bridge)
    bridge.wait_for("ready")
    async with driving(config, tmp_path, "anna") as (anna,):

        async def at(x_m: float, y_m: float) -> None:
            async with asyncio.timeout(WAIT_S):
                while True:
                    pose = anna.requestor.status.get(Topic(ros_domain, 2, 1221))
                    if pose is not None and list(pose.values[:2]) == pytest.approx([x_m, y_m], abs=0.06):
                        return
                    await asyncio.sleep(0.05)

        await anna.acquired()
        await anna.drive(0.1, 0.0)
        await at(2.0, 1.0)
        assert anna.model.robot_timeout_s == 0.5
        # With its acceleration, 2 s are less than a metre; then it stands.
        await anna.drive(2.0, 0.5)
        await anna.drive(2.0, 0.0)
        pose = anna.requestor.status[Topic(ros_domain, 2, 1221)]
        way_m = float(pose.values[0]) - 2.0
        assert 0.5 < way_m < 1.2
        await anna.drive(1.5, 0.0)
        await at(2.0 + way_m, 1.0)
