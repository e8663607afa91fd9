"""`ua-fleet config add-topics` with real rclpy nodes and a bridge."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests import system
from tests.integration.ros2.conftest import Ros2Space

pytestmark = pytest.mark.needs("ros2")

FLEET = """version: 1
pubsub: {{security: none, url: "{url}"}}
bridges:
  mobile: {{kind: ros2, space: {domain}, status_id: 1900}}  # the floor
"""


def config(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return system.run(sys.executable, "-m", "ua_fleet.cli", "config", *arguments, folder=folder)


def test_topics_of_a_running_domain_are_written(ros2: Ros2Space, tmp_path: Path) -> None:
    ros2.talker("/carrier/imu", "sensor_msgs/Imu", {"orientation": {"w": 1.0}})
    ros2.talker("/carrier/lamp", "std_msgs/Bool", {"data": True})
    ros2.listener("/cmd_vel", "geometry_msgs/Twist")
    ros2.bridge()  # its own topics are nobody's data
    (tmp_path / "fleet.yaml").write_text(before := FLEET.format(url=ros2.udp_url, domain=ros2.domain))
    unsaid = config("add-topics", "mobile", folder=tmp_path)
    assert unsaid.returncode == 0, unsaid.stderr
    assert "/cmd_vel: whose is it? give --robot; robots of this bridge: none" in unsaid.stderr
    assert (tmp_path / "fleet.yaml").read_text() == before
    done = config("add-topics", "mobile", "--robot", "carrier", "--max-rate-hz", "5", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    after = (tmp_path / "fleet.yaml").read_text()
    assert after.startswith(before)
    robot = yaml.safe_load(after)["robots"]["carrier"]
    assert robot["bridge"] == "mobile"
    data = robot["data"]
    assert sorted(data) == ["cmd_vel", "imu", "lamp"]
    assert data["lamp"] == {
        "id": 1902,
        "type": "Boolean",
        "source": {"topic": "/carrier/lamp", "type": "std_msgs/Bool", "max_rate_hz": 5},
    } | {"id": data["lamp"]["id"]}
    assert data["cmd_vel"]["origin"] == "server"
    assert data["cmd_vel"]["sink"] == {"topic": "/cmd_vel", "type": "geometry_msgs/Twist"}
    assert list(data["cmd_vel"]["fields"]) == [f"{part}.{axis}" for part in ("linear", "angular") for axis in "xyz"]
    assert "header.frame_id" not in data["imu"]["fields"]
    assert data["imu"]["fields"]["orientation_covariance"] == {"type": "Double", "array": True}
    checked = config("check", "--ros", folder=tmp_path)
    assert (checked.returncode, checked.stderr) == (0, "")


def test_a_bridge_of_a_kind_without_topics_says_so(tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text(
        "version: 1\npubsub: {security: none}\nbridges:\n"
        "  hall: {kind: modbus, space: 300, status_id: 1, devices: {plc: {host: 127.0.0.1}}}\n"
    )
    ended = config("add-topics", "hall", folder=tmp_path)
    assert ended.returncode != 0
    assert "bridges of kind modbus have no topics" in ended.stderr
