"""Each how-to, from its fleet.yaml to a skill that is done, against a simulated device or real ROS nodes."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests import system
from tests.docs.walkthrough import PASSWORD, Walk
from tests.unit.docs.pages import ROOT
from tests.ur_controller import free_loopback
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore

PAGES = ROOT / "docs" / "how-to"
MOST_LINES = 125


@pytest.fixture
def walk(
    folder: Path, environment: dict[str, str], processes: system.Processes
) -> Callable[[str, dict[str, str]], str]:
    """Walks through a page as somebody who has read the tutorial: there is anna, and the server trusts her client.

    What the last command of the page has shown is what it gives.
    """
    users = UserStore(folder / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.path.parent.mkdir()
    users.add("anna", PASSWORD, Role.OPERATOR)
    environment["UA_FLEET__SERVER__TRUST_ALL_CLIENTS"] = "true"

    def walk(name: str, instead: dict[str, str]) -> str:
        return Walk(folder, processes, environment, instead).walk(PAGES / name)

    return walk


def test_a_plc(walk: Callable[[str, dict[str, str]], str]) -> None:
    shown = walk("plc.md", {"5020": str(system.free_tcp_port())})
    assert "moved = 200" in shown.splitlines()


def test_a_robot_on_a_tcp_socket(walk: Callable[[str, dict[str, str]], str]) -> None:
    shown = walk("tcp-robot.md", {"127.0.0.1:1025": f"127.0.0.1:{system.free_tcp_port()}"})
    assert "Fleet/Robots/press/Data/position/x = 120.0 mm" in shown


@pytest.mark.needs("ur")
def test_a_universal_robots_arm(walk: Callable[[str, dict[str, str]], str]) -> None:
    shown = walk("ur.md", {"127.0.0.2": free_loopback()})
    assert 'state/robot_mode = "RUNNING"' in shown


@pytest.mark.needs("ros2")
def test_a_ros_2_robot(walk: Callable[[str, dict[str, str]], str], ros_domain: int) -> None:
    domain = {"space: 2\n": f"space: {ros_domain}\n", "ROS_DOMAIN_ID=2 ": f"ROS_DOMAIN_ID={ros_domain} "}
    shown = walk("ros2-robot.md", domain)
    assert 'text = "docked"' in shown.splitlines()


@pytest.mark.needs("ros1")
def test_a_ros_1_robot(walk: Callable[[str, dict[str, str]], str], environment: dict[str, str], tmp_path: Path) -> None:
    port = str(system.free_tcp_port())
    environment |= {
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
        "ROS_IP": "127.0.0.1",
        "ROS_LOG_DIR": str(tmp_path / "log"),
        "ROS_HOME": str(tmp_path / "ros"),
        "UA_FLEET_RUNTIME_DIR": str(tmp_path),
    }
    shown = walk("ros1-robot.md", {"11311": port, "~/ua_fleet/": f"{ROOT}{os.sep}"})
    assert 'text = "parked"' in shown.splitlines()


def test_pages_are_short() -> None:
    lengths = {page.name: len(page.read_text(encoding="utf-8").splitlines()) for page in PAGES.glob("*.md")}
    assert len(lengths) >= 5
    assert {name: count for name, count in lengths.items() if count > MOST_LINES} == {}
