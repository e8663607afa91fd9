"""The robots' programs of docs/ros.md, run as they stand there."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests import system
from tests.integration.ros1.ros1_graph import Ros1Graph
from tests.integration.ros2.conftest import Ros2Space
from tests.unit.docs.pages import ROOT, blocks

pytestmark = [pytest.mark.needs("ros1"), pytest.mark.needs("ros2")]


def program(library: str, domain: int) -> str:
    """The example that imports the library, for another domain than 2."""
    found = [block.text for block in blocks("python") if block.page == ROOT / "docs" / "ros.md"]
    (text,) = [text for text in found if f"import {library}\n" in text]
    return text.replace("ua_2_2_", f"ua_{domain}_2_")


def test_two_robots_hear_each_other(processes: system.Processes, tmp_path: Path, udp_url: str, ros_domain: int) -> None:
    folders = [tmp_path / name for name in ("ros1", "ros2")]
    for folder in folders:
        folder.mkdir()
    graph = Ros1Graph(processes, folders[0], udp_url)
    domain = Ros2Space(ros_domain, udp_url, folders[1], processes)
    graph.master()
    graph.bridge()
    domain.bridge()
    arm = processes.start(system.ROS1_PYTHON, "-c", program("rospy", ros_domain), env=graph.env)
    carrier = processes.start(sys.executable, "-c", program("rclpy", ros_domain), env=domain.environment())
    carrier.wait_for("parked True")
    arm.wait_for("battery 0.8")
