"""A run that cannot begin a task says at once which robot cannot, since when, by what, and what a person can do."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.operation.runs.world import ACCEPTED, CONFIG, World
from ua_fleet.config.resilience_schema import ModeName
from ua_fleet.errors import ScenarioError
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import RobotState
from ua_fleet.operation.runs.library import ScenarioUnknown
from ua_fleet.operation.runs.records import DecisionRecord, RunRecord
from ua_fleet.orchestrator import DecisionChanged, RunChanged, TaskWaiting
from ua_fleet.scenario.consequences import HALT_S, NOT_HALTED
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome
from ua_fleet.values import BuiltinType, NodeId

OPERATOR = CONFIG.model_copy(
    update={"resilience": CONFIG.resilience.model_copy(update={"mode": ModeName.OPERATOR, "limit_s": 60.0})}
)
TWO = """version: 1
name: two
steps:
  - {task: first, skill: grab, robot: left, arguments: {angle: 5}}
  - {task: second, skill: grab, robot: left, arguments: {angle: 6}}
"""


def record_of(world: World, run_id: str) -> RunRecord:
    """The run, as its node shows it."""
    record = RunRecord(run_id)
    decisions: dict[str, DecisionRecord] = {}
    for output in world.said:
        if getattr(output, "run_id", "") != run_id:
            continue
        if isinstance(output, RunChanged):
            record.apply(output.fact)
        elif isinstance(output, TaskWaiting):
            record.show_waiting(output.waits)
        elif isinstance(output, DecisionChanged):
            decision = decisions.setdefault(output.event.decision_id, DecisionRecord.of(output))
            decision.apply(output)
            record.show_decision(decision, output.until)
    return record


def timed_out(world: World) -> str:
    """A run whose second task takes too long, on a robot that does not say that it has stopped."""
    run_id = world.start(TWO)
    world.service.concluded(
        world.robots.asked[-1][2], RequestOutcome(OutcomeKind.ACCEPTED, ExecutionReport(ExecutionState.DONE))
    )
    world.service.concluded(world.robots.asked[-1][2], ACCEPTED)
    world.pass_time(5 + HALT_S)
    return run_id


def test_who_timed_out_is_named_with_task_and_run_to_the_next_run(tmp_path: Path) -> None:
    world = World(tmp_path, config=OPERATOR)
    first = timed_out(world)
    world.pass_time(61)
    assert [fault.id for fault in world.service.faults if fault.active] == ["left.not_halted"]
    world.service.fault_reports.raise_fault("right", "gripper stuck")
    run_id = world.start(TWO)
    reason = record_of(world, run_id).shown_reason
    assert reason.startswith("task first waits: left has a fault: it was told to stop grab (task second of run ")
    assert f"task second of run {first}" in reason
    assert "(left.not_halted, since 1970-01-01 00:0" in reason
    assert "run: ua-fleet fault clear left.not_halted; no other robot can do it now: ua-fleet scenario abort " in reason
    assert " ends the run; waits until " in reason
    world.pass_time(61)
    said = world.ended()[-1]
    assert said.startswith("failed task first was not begun: left has a fault: ")
    assert f"task second of run {first}" in said


def test_a_run_that_waits_for_a_fault_goes_on_once_it_is_cleared(tmp_path: Path) -> None:
    """Nobody has to choose the robot that the task names."""
    world = World(tmp_path, config=OPERATOR)
    timed_out(world)
    world.pass_time(61)
    run_id, asked = world.start(TWO), len(world.robots.asked)
    world.service.fault_reports.clear_fault(f"left.{NOT_HALTED}")
    assert len(world.robots.asked) == asked + 1
    assert world.service.open_decisions == 0
    assert record_of(world, run_id).shown_reason == ""


def test_a_restart_knows_what_was_halted(tmp_path: Path) -> None:
    world = World(tmp_path, config=OPERATOR)
    first = timed_out(world)
    world.journal.close()
    after = World(tmp_path, config=OPERATOR)
    after.pass_time(61)
    (fault,) = [fault for fault in after.service.faults if fault.source == NOT_HALTED]
    assert f"it was told to stop grab (task second of run {first}: not done in 5 s)" in fault.reason
    after.journal.close()


def test_a_robot_that_is_heard_before_its_bridge_in_the_same_batch_is_not_silent_for_ever(tmp_path: Path) -> None:
    """As where a broker that was away hands on at once what it has kept: what is queued of the robot is not over."""
    world = World(tmp_path)
    world.value("900.Online", True, BuiltinType.BOOLEAN)
    world.value("900.Online", False, BuiltinType.BOOLEAN)
    world.silence("left")
    world.pass_time(1)
    assert [fault.id for fault in world.service.faults if fault.active] == ["left.silent"]
    batch: list[tuple[str, BuiltinType, object]] = [
        ("Robots.left.State", BuiltinType.INT32, RobotState.IDLE),
        ("900.Online", BuiltinType.BOOLEAN, True),
    ]
    for key, kind, value in batch:
        world.service.value_changed(ValueChanged(NodeId(2, key), int(kind), value, 0, 1, can_wait=False))
    world.service.end_batch()
    world.pass_time(1)
    assert not [fault.id for fault in world.service.faults if fault.active]


def test_a_robot_whose_bridge_is_away_says_which_and_what_to_run(tmp_path: Path) -> None:
    world = World(tmp_path, config=OPERATOR)
    world.value("900.Online", True, BuiltinType.BOOLEAN)
    world.value("900.Online", False, BuiltinType.BOOLEAN)
    world.silence("left")
    run_id = world.start(TWO)
    away = "its bridge cell is not there since 1970-01-01 00:01:40 UTC; run it: ua-fleet bridge cell"
    assert record_of(world, run_id).shown_reason == f"task first waits: nothing is heard of left: {away}"
    (fault,) = [fault for fault in world.service.faults if fault.active]
    assert (fault.id, fault.reason) == ("left.silent", f"it is silent: {away}")
    world.value("900.Online", True, BuiltinType.BOOLEAN)
    world.pass_time(1)
    there = "its bridge cell is there; see to the robot"
    assert record_of(world, run_id).shown_reason == f"task first waits: nothing is heard of left: {there}"
    (fault,) = [fault for fault in world.service.faults if fault.active]
    assert fault.reason == f"it is silent: {there}"
    world.state("left", RobotState.IDLE)
    assert record_of(world, run_id).shown_reason == ""
    assert len(world.robots.asked) == 1


def test_a_run_that_ends_for_a_bridge_that_is_away_names_it(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.value("900.Online", False, BuiltinType.BOOLEAN)
    world.silence("left")
    world.silence("right")
    world.start()
    world.pass_time(200)
    assert world.ended()[-1].startswith(
        "failed task a was not begun: nothing is heard of left for 30 s: its bridge cell"
    )


def test_a_fault_is_cleared_by_its_id(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.service.fault_reports.raise_fault("left", "gripper stuck")
    world.value(1300, "motor hot", BuiltinType.STRING)
    with pytest.raises(ScenarioUnknown, match=r"its faults now: left\.robot, left\.announced$"):
        world.service.fault_reports.clear_fault("left.grab")
    with pytest.raises(ScenarioError, match="still there"):
        world.service.fault_reports.clear_fault("left.announced")
    world.service.fault_reports.clear_fault("left.robot")
    assert [fault.id for fault in world.service.faults if fault.active] == ["left.announced"]
    with pytest.raises(ScenarioUnknown, match="there is no robot 'nobody'"):
        world.service.fault_reports.clear_fault("nobody.robot")


def test_what_nobody_knows_is_asked_with_the_command_that_answers(tmp_path: Path) -> None:
    world = World(tmp_path, config=OPERATOR)
    run_id = timed_out(world)
    reason = record_of(world, run_id).shown_reason
    assert f"ua-fleet scenario answer {run_id} second done|retry|fail" in reason
    assert "decision confirm" in reason


def test_a_run_that_waits_for_a_robot_of_another_run_names_it_until_it_has_its_robot(tmp_path: Path) -> None:
    world = World(tmp_path)
    first = world.start(TWO)
    second = world.start(TWO.replace("first", "third"))
    record = record_of(world, second)
    reason = f"left does task first of run {first}; ua-fleet scenario abort {first} ends that run"
    assert record.shown_reason == f"task third waits: {reason}"
    (row,) = record.rows()
    assert (row.task, row.robot, row.state, row.message) == ("third", "left", "wanted", reason)
    world.pass_time(3)
    assert record_of(world, second).rows() == [row], "it stays while it is so"
    world.journal.close()
    world = World(tmp_path, robots=world.robots)
    assert record_of(world, second).shown_reason == f"task third waits: {reason}", "also after a restart"
    world.service.runs.abort(first, "", "anna")
    world.pass_time(HALT_S)
    world.service.fault_reports.clear_fault(f"left.{NOT_HALTED}")
    assert record_of(world, second).shown_reason == ""
