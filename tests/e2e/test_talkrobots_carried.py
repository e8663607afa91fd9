"""The nine tasks carried by seven bridges, as a user runs them; the robot that fails is replaced without the server."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.e2e.talkrobots import demonstration
from tests.e2e.test_talkrobots import KINDS, TASKS
from tests.system import Processes


@pytest.mark.needs("ros1", "ros2", "ur")
def test_bridges_carry_the_nine_tasks(processes: Processes, tmp_path: Path) -> None:
    options = ("--speed", "15", "--mode", "carried", "--resilience", "automatic", "--no-console")
    with demonstration(processes, tmp_path, *options) as started:
        report = started.finish(150)
    rows = report["tasks"]
    assert sorted(row["task"] for row in rows) == sorted(TASKS)
    assert {row["state"] for row in rows} == {"done"}
    robots = {row["task"]: row["robot"] for row in rows}
    assert robots["fetch"] == robots["load"] == "ridgeback"
    assert robots["approach"] == robots["bring"] == "pioneer_1"
    messages = report["messages"]
    assert messages.keys() == KINDS
    assert 0 < messages["token"] < 200
    begun = [line for line in started.child.lines if " begins " in line]
    for task in TASKS:
        again = task == "approach"  # Ridgeback begins it, and its drive fails
        assert sum(f" begins {task} " in f"{line} " for line in begun) == 1 + again, begun


def test_nobody_is_asked_who_takes_over(processes: Processes, tmp_path: Path) -> None:
    with demonstration(processes, tmp_path, "--mode", "carried") as started:
        assert started.child.process.wait(60) == 2
        assert any("--resilience automatic" in line for line in started.child.lines)
