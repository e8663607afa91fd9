"""The nine tasks as a user runs them: one command, real ROS nodes and controllers, fifteen times faster."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from ua_demo.talkrobots.setting import ACTORS

from tests.e2e.console import check_console
from tests.e2e.talkrobots import demonstration
from tests.system import Processes

TASKS = ["fetch", "transport", "grasp", "approach", "take_off", "pick_left", "bring", "land", "load"]
KINDS = {
    *("registration", "metadata", "request", "response", "status", "token", "fault", "keep_alive", "repeat"),
    *("telemetry", "sensor", "run"),
}
WORDS = 4 * 11
"""Ten executions and one halt, each asked for, answered, and both acknowledged."""
LEAST_WORD_BYTES = 54
COUNTED = ("registration", "request", "response", "status", "token", "fault")


def check_course(report: dict[str, Any]) -> None:
    rows = report["tasks"]
    assert sorted(row["task"] for row in rows) == sorted(TASKS)
    assert {row["state"] for row in rows} == {"done"}
    assert all(0 <= row["started_s"] < row["ended_s"] for row in rows)
    by_task = {row["task"]: row for row in rows}
    in_order = ["fetch", "transport", "grasp", "approach", "pick_left", "bring"]
    for before, after in pairwise(in_order):
        assert by_task[before]["ended_s"] <= by_task[after]["started_s"]
    assert by_task["take_off"]["started_s"] < by_task["pick_left"]["ended_s"], "side by side"
    assert by_task["bring"]["ended_s"] <= min(by_task[task]["started_s"] for task in ("land", "load"))
    assert by_task["land"]["started_s"] < by_task["load"]["ended_s"], "side by side"
    assert by_task["load"]["started_s"] < by_task["land"]["ended_s"], "side by side"


@pytest.mark.needs("ros1", "ros2", "ur")
def test_the_best_robot_takes_over_by_itself(processes: Processes, tmp_path: Path) -> None:
    with demonstration(processes, tmp_path, "--speed", "15", "--resilience", "automatic") as started:
        check_console(started.child, "TalkRoBots", {actor.name for actor in ACTORS})
        report = started.finish(150)
    check_course(report)
    robots = {row["task"]: row["robot"] for row in report["tasks"]}
    assert robots == {
        "fetch": "ridgeback",
        "transport": "conveyor",
        "grasp": "ur3",
        "approach": "pioneer_1",
        "take_off": "drone",
        "pick_left": "ur3",
        "bring": "pioneer_1",
        "land": "drone",
        "load": "ridgeback",
    }
    fault = report["fault"]
    assert (fault["robot"], fault["task"], fault["replacement"]) == ("ridgeback", "approach", "pioneer_1")
    assert 0 < fault["detected_s"] <= fault["decided_s"]
    assert [place["robot"] for place in fault["ranking"]] == ["pioneer_1", "pioneer_2"]
    assert sum(place["score"] for place in fault["ranking"]) == pytest.approx(1)
    for place in fault["ranking"]:
        assert place["per_criterion"].keys() == {"battery", "distance", "availability"}
    assert 0 < fault["consistency_ratio"] <= 0.1
    messages, size = report["messages"], report["bytes"]
    assert messages.keys() == size.keys() == KINDS
    # A machine that is too busy to answer within 0.1 s has words said again, which costs it as much as a bad network.
    again = messages["request"] + messages["response"] - WORDS
    assert 0 <= again <= 20, messages
    assert sum(messages[kind] for kind in COUNTED) - again < 104, messages
    assert sum(size[kind] for kind in COUNTED) - again * LEAST_WORD_BYTES < 15_100, size
    assert messages["sensor"] > 0
    assert report["paper"] == {"measured": 284, "best": 251, "worst": 299}
    printed = "\n".join(started.child.lines)
    assert "no candidate: ridgeback lacks mobile: the drive does not turn" in printed
    assert "what Eq. 12 counts" in printed


def test_a_process_that_does_not_start_is_named_with_its_log(processes: Processes, tmp_path: Path) -> None:
    (tmp_path / "run" / "state" / "server.db").mkdir(parents=True)
    with demonstration(processes, tmp_path, "--speed", "15", "--without-ros1") as started:
        line = started.child.wait_for("ua-fleet: server ended with code", timeout_s=60)
        assert started.child.process.wait(60) == 1
    assert line.endswith(f"see {tmp_path / 'run' / 'log' / 'server.log'}")
