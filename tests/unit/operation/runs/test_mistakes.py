"""A mistake of ours in one run costs that run: it is counted and logged once, and no robot is told anything for it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from tests.unit.operation.runs.world import ACCEPTED, ONE, World
from ua_fleet.orchestrator.choosing import Choosing
from ua_fleet.orchestrator.halts import Halts
from ua_fleet.scenario import Run
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.skill.status import ExecutionStatus
from ua_fleet.values import BuiltinType

ANYBODY = ONE.replace("robot: left, ", "capacity: gripper, ")


def broken(*_given: Any, **_named: Any) -> Any:
    raise ZeroDivisionError("nobody has thought of it")


def test_a_broken_run_beside_a_good_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(tmp_path)
    with monkeypatch.context() as patch, capture_logs() as lines:
        patch.setattr(Choosing, "ranked", broken)
        world.value(1300, "stuck", BuiltinType.STRING)
        bad = [world.start(), world.start()]  # somebody has to take over, and nobody can be found
        good = world.start(ONE.replace("robot: left", "robot: right"))
    assert world.service.run_ids == [good]
    assert [reason.partition(": ")[0] for reason in world.ended()] == [
        "failed a mistake of ua_fleet (ZeroDivisionError"
    ] * 2
    assert (world.mistakes.counts["runs"], "ZeroDivisionError" in world.mistakes.last) == (2, True)
    told = [line for line in lines if line.get("loop") == "runs"]
    assert [(line["run_id"], isinstance(line["exc_info"], ZeroDivisionError)) for line in told] == [(bad[0], True)]
    ((robot, _, execution_id),) = world.robots.asked
    assert robot == "right"
    world.service.concluded(execution_id, ACCEPTED)
    world.hear(1201, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
    assert world.ended()[-1] == "done"


def test_what_a_broken_run_would_have_begun_is_not_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its robot is granted, and then the same breath meets a mistake."""
    world = World(tmp_path)
    two = "  - parallel:\n      - {task: a, skill: grab, robot: left}\n      - {task: b, skill: grab, robot: right}\n"
    granted = Run.granted

    def second_is_broken(run: Run, step: str, robot: str, *given: Any) -> Any:
        return broken() if robot == "right" else granted(run, step, robot, *given)

    monkeypatch.setattr(Run, "granted", second_is_broken)
    world.start(f"version: 1\nname: two\nsteps:\n{two}")
    world.pass_time(60)
    assert (world.robots.asked, world.robots.halted) == ([], [])
    assert world.mistakes.counts["runs"] == 1


def test_a_mistake_with_halts_keeps_no_run_from_going_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(tmp_path)
    first = world.start()
    world.service.concluded(world.robots.asked[0][2], ACCEPTED)
    world.service.runs.abort(first, "enough", "anna")
    monkeypatch.setattr(Halts, "unanswered", broken)
    world.pass_time(15)
    world.start(ONE.replace("robot: left", "robot: right"))
    assert [robot for robot, _, _ in world.robots.asked] == ["left", "right"]
    assert world.mistakes.counts["halts"] > 0
