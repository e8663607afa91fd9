from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from ua_fleet.bridge.launch import ROS1_PYTHON_VARIABLE, child_environment, find_ros1_python

MARK = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
SITE = "/x/.venv/lib/python3.11/site-packages"


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"A": "1"}, {"A": "1"}),
        ({"LD_LIBRARY_PATH": "/opt/cuda"}, {"LD_LIBRARY_PATH": "/opt/cuda"}),
        ({MARK: "1"}, {}),
        ({MARK: "1", "LD_LIBRARY_PATH": f"{SITE}/ros_rcl.libs:/x/.venv/lib:{SITE}/ros_fastrtps.libs"}, {}),
        (
            {MARK: "1", "LD_LIBRARY_PATH": f"{SITE}/ros_rcl.libs:/opt/cuda:/x/.venv/lib:/usr/local/lib:"},
            {"LD_LIBRARY_PATH": "/opt/cuda:/usr/local/lib"},
        ),
        ({MARK: "1", "LD_LIBRARY_PATH": "/opt/ros/noetic/lib"}, {"LD_LIBRARY_PATH": "/opt/ros/noetic/lib"}),
    ],
)
def test_child_gets_the_users_environment_and_nothing_of_the_wheels(
    environment: dict[str, str], expected: dict[str, str]
) -> None:
    before = dict(environment)
    assert child_environment(environment) == expected
    assert environment == before


def test_child_of_this_interpreter_does_not_see_our_libraries() -> None:
    printed = subprocess.run(
        ["/usr/bin/env"], env=child_environment(os.environ), capture_output=True, text=True, check=True
    ).stdout
    assert MARK not in printed
    assert ".libs" not in printed


def _make_python(folder: Path) -> Path:
    python = folder / ".venv-ros1" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text("#!/bin/sh\n")
    python.chmod(0o755)
    return python


def test_ros1_python_is_beside_our_environment(tmp_path: Path) -> None:
    python = _make_python(tmp_path)
    assert find_ros1_python({}, prefix=str(tmp_path / ".venv")) == python


def test_ros1_python_may_be_in_the_working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    python = _make_python(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert find_ros1_python({}, prefix="/nowhere/.venv") == python


def test_ros1_python_that_the_user_names_comes_first(tmp_path: Path) -> None:
    _make_python(tmp_path)
    named = _make_python(tmp_path / "other")
    assert find_ros1_python({ROS1_PYTHON_VARIABLE: str(named)}, prefix=str(tmp_path / ".venv")) == named


def test_no_ros1_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_ros1_python({}, prefix=str(tmp_path / ".venv")) is None
    assert find_ros1_python({ROS1_PYTHON_VARIABLE: str(tmp_path / "missing")}, prefix=str(tmp_path)) is None
