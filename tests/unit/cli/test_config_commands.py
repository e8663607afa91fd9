from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.unit.cli.conftest import Invoke


def test_from_nothing_to_a_valid_file(invoke: Invoke, tmp_path: Path) -> None:
    ended = invoke("config", "init")
    assert (ended.code, ended.stdout) == (0, "fleet.yaml\nfleet.schema.json\n")
    assert ended.stderr == "edit it, then run: ua-fleet config check fleet.yaml\n"
    ended = invoke("config", "check")
    assert ended.code == 2
    line = (tmp_path / "fleet.yaml").read_text(encoding="utf-8").splitlines().index("pubsub:") + 1
    assert f"fleet.yaml:{line}:pubsub.security: `security` is missing; add `security: sign_and_encrypt`" in ended.stdout
    assert ended.stderr == "ua-fleet: 9 problems; correct them, then run: ua-fleet config check fleet.yaml\n"
    ended = invoke("config", "assign-ids")
    assert ended.code == 2
    assert "pubsub.security" in ended.stderr
    path = tmp_path / "fleet.yaml"
    path.write_text(path.read_text().replace("#security: none", "security: none"))
    ended = invoke("config", "assign-ids")
    assert ended.code == 0
    assert ended.stdout.splitlines()[0] == "bridges.cell.status_id: 1001"
    assert ended.stderr == "fleet.yaml: 8 ids assigned\n"
    ended = invoke("config", "check")
    assert (ended.code, ended.stdout) == (0, "fleet.yaml: valid; bridges: 2, robots: 2, data sources: 4\n")
    ended = invoke("config", "assign-ids")
    assert (ended.code, ended.stdout) == (0, "")
    assert ended.stderr == "fleet.yaml: nothing to do, all ids exist\n"
    ended = invoke("config", "init")
    assert ended.code == 2
    assert ended.stderr == "ua-fleet: fleet.yaml: exists already; choose another name\n"


def test_json(invoke: Invoke, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    assert json.loads(invoke("config", "init", "a.yaml", "--json").stdout) == {
        "file": "a.yaml",
        "schema": "fleet.schema.json",
    }
    path.write_text("version: 1\npubsub: {security: none, tll: 1}\nbridges:\n  c: {kind: ros1}\n")
    ended = invoke("config", "check", "a.yaml", "--json")
    assert ended.code == 2
    assert json.loads(ended.stdout) == {
        "valid": False,
        "problems": [
            {
                "file": "a.yaml",
                "line": 2,
                "key": "pubsub.tll",
                "message": "unknown key `tll`",
                "suggestion": "did you mean `ttl`?",
            },
            {
                "file": "a.yaml",
                "line": 4,
                "key": "bridges.c.status_id",
                "message": "`status_id` is missing",
                "suggestion": "run: ua-fleet config assign-ids a.yaml",
            },
        ],
    }
    path.write_text("version: 1\npubsub: {security: none}\nbridges:\n  c: {kind: ros1}\n")
    given = json.loads(invoke("config", "assign-ids", "a.yaml", "--json").stdout)
    assert given == {"assigned": {"bridges.c.status_id": 1001}}
    assert json.loads(invoke("config", "check", "a.yaml", "--json").stdout) == {
        "valid": True,
        "bridges": 1,
        "robots": 0,
        "data_sources": 0,
        "problems": [],
    }


def test_the_environment_counts(invoke: Invoke, fleet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UA_FLEET__SERVER__PORT", "x")
    ended = invoke("config", "check")
    assert ended.code == 2
    assert ended.stdout == "environment:UA_FLEET__SERVER__PORT: must be a whole number, not `x`\n"
    monkeypatch.delenv("UA_FLEET__SERVER__PORT")
    monkeypatch.setenv("UA_FLEET_CONFIG", str(fleet))
    monkeypatch.chdir("/")
    assert invoke("config", "check").code == 0


def test_scenarios_are_held_against_the_fleet(invoke: Invoke, tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text("version: 1\npubsub: {security: none}\n")
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "one.yaml").write_text(
        "version: 1\nname: one\nsteps:\n  - {task: a, skill: go, robot: ur3}\n"
    )
    ended = invoke("config", "check")
    assert (ended.code, ended.stdout) == (
        2,
        "scenarios/one.yaml:4: task 'a': there is no robot 'ur3'; known robots: none\n",
    )
    (problem,) = json.loads(invoke("config", "check", "--json").stdout)["problems"]
    assert (problem["file"], problem["line"]) == ("scenarios/one.yaml", 4)
    assert invoke("config", "check", "--no-scenarios").code == 0


def test_schema(invoke: Invoke, tmp_path: Path) -> None:
    ended = invoke("config", "schema")
    assert (ended.code, json.loads(ended.stdout)["title"]) == (0, "fleet.yaml")
    assert json.loads(invoke("config", "schema", "--scenario").stdout)["title"] == "scenario"
    ended = invoke("config", "schema", "-o", "my.schema.json")
    assert (ended.code, ended.stdout) == (0, "my.schema.json\n")
    assert json.loads((tmp_path / "my.schema.json").read_text(encoding="utf-8"))["title"] == "fleet.yaml"
    ended = invoke("config", "schema", "-o", "no/my.schema.json")
    assert ended.code == 2
    assert ended.stderr == "ua-fleet: no/my.schema.json: cannot be written: no such file or directory\n"


def test_show(invoke: Invoke, fleet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UA_FLEET__SERVER__PORT", "4901")
    ended = invoke("config", "show", "server.port", "robots.ned.bridge")
    assert (ended.code, ended.stdout) == (0, "server: {port: 4901}\nrobots:\n  ned: {bridge: cell}\n")
    ended = invoke("config", "show", "server.port", "robots.ned.bridge", "pubsub.ttl", "--origin")
    assert [line.split() for line in ended.stdout.splitlines()] == [
        ["key", "value", "from"],
        ["server.port", "4901", "UA_FLEET__SERVER__PORT"],
        ["pubsub.ttl", "1", "default"],
        ["robots.ned.bridge", "cell", "fleet.yaml:7"],
    ]
    assert json.loads(invoke("config", "show", "server.port", "--json").stdout) == {"server": {"port": 4901}}
    ended = invoke("config", "show", "server.port", "robots.ned.bridge", "--json", "--origin")
    assert [json.loads(line) for line in ended.stdout.splitlines()] == [
        {"key": "server.port", "value": 4901, "origin": {"environment": "UA_FLEET__SERVER__PORT"}},
        {"key": "robots.ned.bridge", "value": "cell", "origin": {"file": "fleet.yaml", "line": 7}},
    ]
    ended = invoke("config", "show", "server.prot")
    assert ended.code == 3
    assert ended.stderr == "ua-fleet: fleet.yaml: `server.prot` has no value; did you mean `server.port`?\n"
    ended = invoke("config", "show", "-c", "none.yaml")
    assert ended.code == 2
    assert "there is no such file" in ended.stderr


ROS = """version: 1
pubsub: {security: none}
bridges:
  floor: {kind: ros2, space: 2, status_id: 1001}
  cell: {kind: ros1, status_id: 1002}
robots:
  carrier:
    bridge: floor
    data:
      odom:
        id: 1003
        fields:
          x: {type: Double, path: pose.z}
          frame: {type: String}
        source: {topic: /odom, type: hall_msgs/Odometry}
      near:
        id: 1004
        type: Double
        source: {topic: /near, type: hall_msgs/Odometri}
  ned:
    bridge: cell
    data:
      odom:
        id: 1005
        type: String
        path: frame
        source: {topic: /odom, type: hall_msgs/Odometry}
      elsewhere:
        id: 1006
        type: Double
        source: {topic: /far, type: far_msgs/Far}
"""


def test_message_types_that_are_installed_are_known(
    invoke: Invoke, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One folder has the package as ROS 2 generates it, another as ROS 1 does."""
    two, one = tmp_path / "two/hall_msgs/msg", tmp_path / "one/hall_msgs/msg"
    for folder in (two, one):
        folder.mkdir(parents=True)
    (two / "__init__.py").write_text(
        "from hall_msgs.msg._odometry import Odometry  # noqa\nfrom hall_msgs.msg._pose import Pose  # noqa\n"
    )
    (two / "_odometry.py").write_text("_fields_and_field_types = {'frame': 'string', 'pose': 'hall_msgs/Pose'}\n")
    (two / "_pose.py").write_text("_fields_and_field_types = {'x': 'double'}\n")
    (one / "__init__.py").write_text("from ._Odometry import *\n")
    (one / "_Odometry.py").write_text("_full_text = 'string frame'\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path / name) for name in ("two", "one")] + sys.path)
    (tmp_path / "fleet.yaml").write_text(ROS)
    assert invoke("config", "check").code == 0
    ended = invoke("config", "check", "--ros")
    assert ended.code == 2
    key = "robots.carrier.data"
    meant = "did you mean `pose.x`? it has: `pose.x`"
    has = "did you mean `hall_msgs/Odometry`? hall_msgs has: `hall_msgs/Odometry`, `hall_msgs/Pose`"
    assert ended.stdout.splitlines() == [
        f"fleet.yaml:13:{key}.odom.fields.x.path: hall_msgs/Odometry has no field pose.z; {meant}",
        f"fleet.yaml:19:{key}.near.source.type: hall_msgs has no message type hall_msgs/Odometri in ROS 2; {has}",
    ]
    doubt = (
        "fleet.yaml:31:robots.ned.data.elsewhere.source.type: messages of far_msgs for ROS 1 are not installed here: "
        "far_msgs/Far was not looked at; install the package here, or check where the bridge runs"
    )
    assert f"not checked: {doubt}\n" in ended.stderr
    # Without --ros the same file is valid.
    assert ended.stderr.endswith("2 problems; correct them, then run: ua-fleet config check --ros fleet.yaml\n")
    right = ROS.replace("pose.z", "pose.x").replace("Odometri}", "Pose}")
    right = right.replace("        type: Double\n", "        type: Double\n        path: x\n", 1)
    (tmp_path / "fleet.yaml").write_text(right)
    ended = invoke("config", "check", "--ros", "--json")
    assert ended.code == 0, ended.stdout
    said = json.loads(ended.stdout)
    assert [one["key"] for one in said["not_checked"]] == ["robots.ned.data.elsewhere.source.type"]


@pytest.mark.parametrize("name", ["x: {", "*x", "a\nb", "'", "- x"])
def test_topics_are_not_added_to_a_robot_whose_name_is_none(invoke: Invoke, fleet: Path, name: str) -> None:
    before = fleet.read_bytes()
    ended = invoke("config", "add-topics", "cell", f"--robot={name}")
    assert ended.code == 2
    assert "is no name of a robot" in ended.stderr
    assert fleet.read_bytes() == before
