"""`ua-fleet state` where folders of `fleet.yaml` cannot be told apart: refused before anything is written or moved."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.cli.conftest import FLEET, Invoke

SHARED = FLEET.replace("status_id: 1}", "status_id: 1, state_dir: state}")
BRIDGES = FLEET.replace(
    "  cell: {kind: ros1, status_id: 1}",
    "  cell: {kind: ros1, status_id: 1, state_dir: b}\n  yard: {kind: ros2, space: 2, status_id: 2, state_dir: ./b/}",
)


def write(folder: Path, text: str) -> None:
    (folder / "fleet.yaml").write_text(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (SHARED, "state: is the folder of server and bridge-cell; give each a folder of its own in fleet.yaml"),
        (BRIDGES, "b: is the folder of bridge-cell and bridge-yard; give each a folder of its own in fleet.yaml"),
        (FLEET + "server: {state_dir: .}\n", "the folder of server has fleet.yaml in it; name one that has not"),
        (FLEET + "server: {state_dir: ''}\n", "the folder of server has fleet.yaml in it; name one that has not"),
        (FLEET + "server: {state_dir: ..}\n", "the folder of server has fleet.yaml in it; name one that has not"),
        (FLEET + "scenarios: {folder: .}\n", "the folder of scenarios has fleet.yaml in it; name one that has not"),
    ],
)
def test_folders_that_cannot_be_restored_are_refused(invoke: Invoke, tmp_path: Path, text: str, said: str) -> None:
    write(tmp_path, FLEET)
    (tmp_path / "state").mkdir(mode=0o700)
    (tmp_path / "state" / "users.yaml").write_text("users: []\n")
    assert invoke("state", "backup", "whole.tar").code == 0
    write(tmp_path, text)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    backup, restore = invoke("state", "backup", "new.tar"), invoke("state", "restore", "whole.tar")
    assert (backup.code, restore.code) == (2, 2)
    assert said in backup.stderr
    assert said in restore.stderr
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before
    if "scenarios" not in text:
        checked = invoke("config", "check")
        assert (checked.code, said in checked.stderr) == (0, True), "the fleet itself runs"


def test_folders_within_each_other_are_apart(invoke: Invoke, tmp_path: Path) -> None:
    write(tmp_path, FLEET)  # state, state/bridges/cell, state/keys
    checked = invoke("config", "check")
    assert (checked.code, checked.stderr) == (0, "")
