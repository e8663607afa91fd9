"""`ua-fleet config add-topics` and `config check --ros` with a real master and rospy nodes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests import system
from tests.integration.ros1.ros1_graph import Ros1Graph

pytestmark = pytest.mark.needs("ros1")

FLEET = """# my hall
version: 1
pubsub: {{security: none}}
bridges:
  cell: {{kind: ros1, status_id: 1001, master_uri: "{uri}"}}
robots:
  ned:   # an arm
    bridge: cell
    data:
      parked: {{id: 1002, type: Boolean, source: {{topic: /ned/parked, type: std_msgs/Bool}}}}
"""


def config(python: str | Path, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return system.run(python, "-m", "ua_fleet.cli", "config", *arguments, folder=folder)


@pytest.mark.parametrize("python", [sys.executable, system.ROS1_PYTHON], ids=["ros2", "ros1"])
def test_topics_of_a_running_graph_are_written(graph: Ros1Graph, tmp_path: Path, python: str | Path) -> None:
    """In either environment: no rospy is needed."""
    graph.master()
    graph.talker("/ned/parked", "std_msgs/Bool", "{data: true}", "--latch", "--name", "one")
    graph.talker("/ned/joints", "sensor_msgs/JointState", "{position: [1.5]}", "--name", "two")
    graph.talker("/ned/mode", "std_msgs/String", "{data: auto}", "--latch", "--name", "three")
    graph.listener("/ned/angle", "std_msgs/Float64")
    (tmp_path / "fleet.yaml").write_text(before := FLEET.format(uri=graph.uri))
    looked = config(python, "add-topics", "cell", "--dry-run", folder=tmp_path)
    assert looked.returncode == 0, looked.stderr
    assert (tmp_path / "fleet.yaml").read_text() == before
    done = config(python, "add-topics", "cell", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "left out: /ned/parked: mapped already: robots.ned.data.parked\n" in done.stderr
    after = (tmp_path / "fleet.yaml").read_text()
    assert after.startswith(before)
    data = yaml.safe_load(after)["robots"]["ned"]["data"]
    assert data == {
        "parked": yaml.safe_load(before)["robots"]["ned"]["data"]["parked"],
        "angle": {
            "id": 1003,
            "origin": "server",
            "type": "Double",
            "sink": {"topic": "/ned/angle", "type": "std_msgs/Float64"},
        },
        "joints": {
            "id": 1004,
            "fields": {
                "name": {"type": "String", "array": True},
                **{name: {"type": "Double", "array": True} for name in ("position", "velocity", "effort")},
            },
            "source": {"topic": "/ned/joints", "type": "sensor_msgs/JointState", "max_rate_hz": 10},
        },
        "mode": {"id": 1005, "type": "String", "source": {"topic": "/ned/mode", "type": "std_msgs/String"}},
    }
    assert config(python, "check", "--ros", folder=tmp_path).returncode == 0
    again = config(python, "add-topics", "cell", folder=tmp_path)
    assert "fleet.yaml: nothing to add\n" in again.stderr
    assert (tmp_path / "fleet.yaml").read_text() == after


def test_without_a_master_it_says_so(tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text(FLEET.format(uri=f"http://127.0.0.1:{system.free_tcp_port()}"))
    ended = config(sys.executable, "add-topics", "cell", folder=tmp_path)
    assert ended.returncode != 0
    assert "no ROS master at http://127.0.0.1:" in ended.stderr
