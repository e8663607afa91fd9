"""The robot's program of docs/teleoperation.md, run as it stands there."""

from __future__ import annotations

import sys

import pytest
from ua_bridges.ros2.environment import PROFILES_VARIABLE, profile_path

from tests import system
from tests.integration.teleoperation.conftest import SPEED, Hall
from tests.integration.teleoperation.driving import driving
from tests.unit.docs.pages import ROOT, blocks
from ua_fleet.teleoperation import State


async def test_the_robot_of_the_page_is_driven_and_stops(hall: Hall, processes: system.Processes) -> None:
    page = ROOT / "docs" / "teleoperation.md"
    (program,) = [one.text for one in blocks("python") if one.page == page and "@robot.driven" in one.text]
    assert "space=2" in program
    config = hall.fleet()
    environment = system.clean_environment(
        ROS_DOMAIN_ID=str(hall.space), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", PYTHONPATH="bridges"
    )
    environment[PROFILES_VARIABLE] = str(profile_path("robot"))
    robot = processes.start(sys.executable, "-c", program.replace("space=2", f"space={hall.space}"), env=environment)
    hall.start_bridge()
    async with driving(config, hall.folder, "anna") as (anna,):
        await anna.acquired()
        await anna.drive(1.5, SPEED)
        await anna.until(lambda status: status.state is State.IDLE)
    speeds = [float(line.split()[0]) for line in robot.lines if line[:1].isdigit()]
    assert speeds[0] == 0.0
    assert max(speeds) == pytest.approx(SPEED)
    assert speeds[-1] == 0.0
