"""Runs beside people who use the same robots: what somebody has halted is not done by another robot, and a
robot that somebody uses is waited for.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.nodes.test_partial_faults import CONFIG as ABLE
from tests.unit.operation.runs.world import ACCEPTED, IMMEDIATE, ONE, World
from ua_fleet.operation.runs.outcomes import refusal
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.orchestrator import DecisionChanged, RunChanged, TaskWaiting
from ua_fleet.resilience import RankingChanged
from ua_fleet.scenario.consequences import BUSY_S, SETTLE_S
from ua_fleet.scenario.facts import TaskOutcome
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.skill.status import ExecutionStatus
from ua_fleet.values import BuiltinType, StatusCode

ANY = ONE.replace("robot: left, arguments: {angle: 5}", "capacity: grab")
TWO = f"{ONE}  - {{task: b, skill: grab, robot: left}}\n  - {{task: c, skill: grab, robot: left}}\n"
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
    world.service.fault_reports.raise_fault("left", "hot")
    world.hear(1200, halted(execution_id))
    assert [asked[0] for asked in world.robots.asked] == ["left", "right"]


def test_what_was_halted_before_it_began_was_halted() -> None:
    assert refusal(HALTED) is TaskOutcome.HALTED


def drive(world: World, status_id: int, state: ExecutionState = ExecutionState.RUNNING) -> None:
    """A robot says that it is at what an operator has started, or is over with it."""
    world.hear(status_id, ExecutionStatus(b"o" * 16, "drive", state))


def asked(world: World) -> list[str]:
    return [robot for robot, *_ in world.robots.asked]


def waiting(world: World) -> list[tuple[str, str]]:
    """Robots and reasons of what tasks wait for, as it was told last."""
    told = {one.waits.step: one.waits for one in world.said if isinstance(one, TaskWaiting)}
    return [(one.robot, one.reason) for one in told.values()]


def test_a_robot_that_an_operator_uses_is_waited_for(tmp_path: Path) -> None:
    world = World(tmp_path)
    drive(world, 1200)
    run_id = world.start()
    world.pass_time(BUSY_S - 1)
    assert asked(world) == []
    assert waiting(world) == [("left", "left is at what no run has asked for")]
    record = RunRecord(run_id)
    for output in world.said:
        if isinstance(output, TaskWaiting):
            record.show_waiting(output.waits)
        elif isinstance(output, RunChanged):
            record.apply(output.fact)
    (row,) = record.rows()
    assert (row.task, row.robot, row.state) == ("a", "left", "wanted")
    assert row.message == "left is at what no run has asked for"
    drive(world, 1200, ExecutionState.DONE)
    assert asked(world) == ["left"]


def test_after_so_long_another_robot_takes_it(tmp_path: Path) -> None:
    world = World(tmp_path)
    drive(world, 1200)
    world.start()
    world.pass_time(BUSY_S + 1)
    assert asked(world) == ["right"]
    assert world.faults() == []


def test_who_is_used_by_an_operator_takes_nothing_over(tmp_path: Path) -> None:
    world = World(tmp_path)
    drive(world, 1201)
    world.start()
    world.service.concluded(world.robots.asked[0][2], ACCEPTED)
    world.value(1300, "broken", BuiltinType.STRING)
    world.pass_time(SETTLE_S + 1)
    assert asked(world) == ["left"]
    events = [one.event for one in world.said if isinstance(one, DecisionChanged)]
    (ranking,) = [event.ranking for event in events if isinstance(event, RankingChanged)][-1:]
    assert "right is at what no run has asked for" in [f"{one.robot} {one.reason}" for one in ranking.excluded]
    drive(world, 1201, ExecutionState.DONE)
    assert asked(world) == ["left", "right"]


def test_any_robot_is_one_that_nobody_uses(tmp_path: Path) -> None:
    world = World(tmp_path, config=ABLE)
    drive(world, 1200)
    world.start(ANY)
    assert asked(world) == ["right"]


def test_where_all_are_used_any_is_waited_for(tmp_path: Path) -> None:
    world = World(tmp_path, config=ABLE)
    for status_id in (1200, 1201):
        drive(world, status_id)
    world.start(ANY)
    world.pass_time(BUSY_S - 1)
    assert asked(world) == []
    ((robot, reason),) = waiting(world)
    assert (robot, "left is at what no run has asked for" in reason) == ("", True)
    drive(world, 1201, ExecutionState.DONE)
    assert asked(world) == ["right"]


def test_where_all_are_used_a_task_fails_after_so_long(tmp_path: Path) -> None:
    world = World(tmp_path, config=ABLE)
    for status_id in (1200, 1201):
        drive(world, status_id)
    world.start(ANY)
    world.pass_time(2 * BUSY_S + 1)  # it is looked for, and then decided
    assert asked(world) == []
    (end,) = world.ended()
    assert "left is at what no run has asked for" in end


def test_what_a_run_has_asked_for_occupies_nobody_else(tmp_path: Path) -> None:
    """A SkillStatus may say of an immediate skill that it runs after its end was told."""
    world = World(tmp_path)
    world.start(TWO)
    world.service.concluded(world.robots.asked[0][2], IMMEDIATE)
    assert asked(world) == ["left", "left"]
    world.hear(1200, ExecutionStatus(world.robots.asked[0][2], "grab", ExecutionState.RUNNING))
    world.service.concluded(world.robots.asked[1][2], IMMEDIATE)
    assert asked(world) == ["left", "left", "left"]
