"""Runs beside people who use the same robots: what somebody has halted is not done by another robot."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.server.scenarios.world import ACCEPTED, ONE, World
from ua_fleet.scenario.facts import TaskOutcome
from ua_fleet.server.scenarios.outcomes import refusal
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.skill.status import ExecutionStatus
from ua_fleet.values import StatusCode

HALTED = int(StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT)


def halted(execution_id: bytes) -> ExecutionStatus:
    return ExecutionStatus(execution_id, "grab", ExecutionState.FAILED, message="it was halted", status=HALTED)


@pytest.mark.parametrize("more", ["", ", retries: 3", ", on_unknown: replace"])
def test_what_an_operator_halts_nobody_else_begins(tmp_path: Path, more: str) -> None:
    world = World(tmp_path)
    world.start(ONE.replace("}}", f"}}{more}}}"))
    ((robot, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.hear(1200, halted(execution_id))
    world.pass_time(60)
    assert [asked[0] for asked in world.robots.asked] == [robot], "whoever pressed Halt may stand in the cell"
    why = "a client halted grab on left, so that nobody begins it: it was halted (BadRequestCancelledByClient)"
    assert world.ended() == [f"failed task a: {why}"]
    assert world.faults() == []


def test_what_a_run_has_halted_itself_another_robot_does(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start()
    ((_, _, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.service.raise_fault("left", "hot")
    world.hear(1200, halted(execution_id))
    assert [asked[0] for asked in world.robots.asked] == ["left", "right"]


def test_what_was_halted_before_it_began_was_halted() -> None:
    assert refusal(HALTED) is TaskOutcome.HALTED
