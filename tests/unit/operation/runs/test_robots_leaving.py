"""Robots that leave the fleet, and come again: what people said of them stays, and they begin nothing meanwhile."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.unit.nodes.test_partial_faults import CONFIG as ABLE
from tests.unit.operation.runs.test_people_at_robots import ANY, asked
from tests.unit.operation.runs.world import ACCEPTED, CONFIG, ONE, World
from ua_fleet.config.schema import FleetConfig
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.model import RobotModel, RobotState
from ua_fleet.operation.runs.library import ScenarioUnknown
from ua_fleet.orchestrator import Hold, HoldChanged, RunChanged
from ua_fleet.scenario.facts import TaskOutcome, TaskOver
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.skill.status import ExecutionStatus
from ua_fleet.values import BuiltinType, NodeId


def _without_left() -> FleetConfig:
    raw = CONFIG.model_dump(mode="json", exclude_unset=True)
    del raw["robots"]["left"]
    raw["resilience"]["faults"]["battery_low"]["robots"] = ["right"]
    return FleetConfig.model_validate(raw)


WITHOUT_LEFT = _without_left()


def active(world: World) -> list[str]:
    return [fault.id for fault in world.service.faults if fault.active]


def keep_from_work(world: World, robot: str, how: str) -> None:
    if how == "fault":
        world.service.fault_reports.raise_fault(robot, "gripper broken")
    else:
        world.service.holds.hold(robot, "gripper broken", "anna")


def left_of(world: World) -> RobotModel:
    return world.service.robots["left"]


@pytest.mark.parametrize("how", ["fault", "hold"])
def test_one_that_is_kept_from_work_gets_no_task_as_it_leaves(tmp_path: Path, how: str) -> None:
    world = World(tmp_path, config=ABLE)
    world.service.holds.hold("right", "new tyre", "anna")
    keep_from_work(world, "left", how)
    world.start(ANY)
    world.pass_time(2)
    assert world.service.users_of("left") == []
    world.service.remove_robot("left")
    world.pass_time(60)
    (ended,) = world.ended()
    assert asked(world) == []
    assert ended.startswith("failed task a was not begun: no robot can do grab: right is held by anna since")
    assert world.mistakes.text() == ""


def announce_anew(world: World, *, is_heard: bool = False) -> None:
    """As the roster does with a robot that its bridge announces with another definition."""
    left = left_of(world)
    world.service.remove_robot("left", is_replaced=True)
    world.service.add_robot(replace(left, description="its program is newer"), is_heard=is_heard)
    if not is_heard:
        world.state("left", RobotState.IDLE)
    world.service.take_news()


@pytest.mark.parametrize("is_heard", [False, True])
@pytest.mark.parametrize("how", ["fault", "hold"])
def test_one_that_is_announced_otherwise_is_kept_from_work_still(tmp_path: Path, how: str, is_heard: bool) -> None:
    world = World(tmp_path, config=ABLE)
    world.service.holds.hold("right", "new tyre", "anna")
    keep_from_work(world, "left", how)
    world.start(ANY)
    world.pass_time(2)
    announce_anew(world, is_heard=is_heard)
    world.pass_time(2)
    assert (asked(world), world.ended(), world.mistakes.text()) == ([], [], ""), "nor is it taken for gone"
    assert [hold.robot for hold in world.service.holds] == (["right"] if how == "fault" else ["right", "left"])
    assert active(world) == (["left.robot"] if how == "fault" else [])
    if how == "fault":
        world.service.fault_reports.clear_fault("left")
    else:
        world.service.holds.release("left", "anna")
    world.pass_time(1)
    assert asked(world) == ["left"]


def test_what_was_found_of_one_that_is_announced_otherwise_stays_until_it_is_over(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.value(1000, 10.0)
    world.value(1300, "the arm is hot", BuiltinType.STRING)
    world.pass_time(1)
    announce_anew(world)
    world.pass_time(1)
    assert sorted(active(world)) == ["left.announced", "left.battery_low"]
    world.value(1000, 90.0)
    world.value(1300, "", BuiltinType.STRING)
    world.pass_time(1)
    assert active(world) == []


def test_silence_of_one_that_is_announced_otherwise_ends_where_it_is_heard(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.silence("left")
    assert active(world) == ["left.silent"]
    announce_anew(world, is_heard=True)
    assert active(world) == []
    world.start(ONE)
    assert asked(world) == ["left"]


def test_one_that_has_not_stopped_is_not_free_when_it_is_announced_otherwise(tmp_path: Path) -> None:
    world = World(tmp_path)
    stop_without_an_answer(world)
    announce_anew(world)
    told = world.service.told_of("left")
    assert told[-1] == "left was told to stop grab, and has not said that it has"
    world.start(ONE)
    world.pass_time(1)
    assert asked(world) == ["left", "right"]
    assert [halt.robot for halt in world.journal.halts()] == ["left"]


@pytest.mark.parametrize("how", ["fault", "hold"])
@pytest.mark.parametrize("restarts", [False, True], ids=["same server", "restart"])
def test_one_that_comes_again_is_kept_from_work_until_somebody_takes_it_back(
    tmp_path: Path, how: str, restarts: bool
) -> None:
    world = World(tmp_path)
    left = left_of(world)
    keep_from_work(world, "left", how)
    world.service.remove_robot("left")
    if restarts:
        world.journal.close()
        world = World(tmp_path, config=WITHOUT_LEFT, heard=["right"])
    world.service.add_robot(left, is_heard=True)
    world.service.take_news()
    world.start(ONE)
    world.pass_time(1)
    assert "left" not in asked(world)
    if how == "fault":
        assert active(world) == ["left.robot"]
        world.service.fault_reports.clear_fault("left")
    else:
        hold = Hold("left", "anna", 100.0, "gripper broken")
        assert [one for one in world.said if isinstance(one, HoldChanged)][-1] == HoldChanged(hold, True, "anna")
        world.service.holds.release("left", "otto")
    world.start(ONE)
    world.pass_time(1)
    assert asked(world)[-1] == "left"


def test_what_is_said_of_one_that_has_left_can_be_taken_back(tmp_path: Path) -> None:
    world = World(tmp_path)
    keep_from_work(world, "left", "fault")
    world.service.remove_robot("left")
    assert active(world) == ["left.robot"]
    world.journal.close()
    world = World(tmp_path, config=WITHOUT_LEFT, heard=["right"])
    assert active(world) == ["left.robot"]
    world.service.fault_reports.clear_fault("left.robot")
    assert active(world) == []
    with pytest.raises(ScenarioUnknown, match="there is no robot 'left'"):
        world.service.fault_reports.clear_fault("left")


def test_the_faults_that_were_found_end_as_it_leaves_and_are_found_again(tmp_path: Path) -> None:
    world = World(tmp_path)
    left = left_of(world)
    world.value(1000, 10.0)
    world.pass_time(1)
    assert active(world) == ["left.battery_low"]
    world.service.remove_robot("left")
    assert active(world) == []
    world.service.add_robot(left, is_heard=True)
    world.value(1000, 9.0)
    world.pass_time(1)
    assert active(world) == ["left.battery_low"]


def test_what_became_known_and_was_not_taken_in_is_nothing_of_a_robot_that_has_left(tmp_path: Path) -> None:
    world = World(tmp_path)
    offline = int(RobotState.OFFLINE)
    world.service.value_changed(
        ValueChanged(NodeId(2, "Robots.left.State"), int(BuiltinType.INT32), offline, 0, 1, False)
    )
    world.service.remove_robot("left")
    world.service.take_news()
    assert active(world) == []


def stop_without_an_answer(world: World) -> None:
    """`left` is told to stop, and nobody hears that it has."""
    run_id = world.start(ONE)
    first = world.robots.asked[0][2]
    world.service.concluded(first, ACCEPTED)
    world.service.runs.abort(run_id, "", "anna")
    world.pass_time(15)
    world.hear(1200, ExecutionStatus(first, "grab", ExecutionState.UNKNOWN, 0.5, "", "the bridge was started anew", 0))
    world.pass_time(1)
    assert active(world) == ["left.not_halted"]
    assert world.service.users_of("left") == []


def test_one_that_has_not_stopped_is_not_free_when_it_comes_again(tmp_path: Path) -> None:
    world = World(tmp_path)
    stop_without_an_answer(world)
    left = left_of(world)
    world.service.remove_robot("left")
    assert [halt.robot for halt in world.journal.halts()] == ["left"]
    world.service.add_robot(left, is_heard=True)
    world.service.take_news()
    world.start(ONE)
    world.pass_time(1)
    assert asked(world) == ["left", "right"], "left for the first run alone"
    world.service.fault_reports.clear_fault("left.not_halted")
    world.start(ONE)
    world.pass_time(1)
    assert asked(world) == ["left", "right", "left"]
    assert world.journal.halts() == []


def test_nor_after_a_restart_at_which_it_was_not_there(tmp_path: Path) -> None:
    world = World(tmp_path)
    stop_without_an_answer(world)
    left = left_of(world)
    world.service.remove_robot("left")
    world.journal.close()
    again = World(tmp_path, config=WITHOUT_LEFT, heard=["right"])
    assert [one.hex() for one in again.service.must_not_begin()] == [world.robots.asked[0][2].hex()]
    assert active(again) == []
    again.service.add_robot(left, is_heard=True)
    again.service.take_news()
    again.start(ONE)
    again.pass_time(15)
    assert "left" not in asked(again)
    assert active(again) == ["left.not_halted"]


def test_what_a_robot_is_at_as_it_leaves_ends_with_the_reason(tmp_path: Path) -> None:
    world = World(tmp_path)
    run_id = world.start(ONE)
    world.service.concluded(world.robots.asked[0][2], ACCEPTED)
    assert world.service.users_of("left") == [run_id], "so that nobody takes it out of the fleet now"
    world.service.remove_robot("left")
    world.pass_time(1)
    over = [one.fact for one in world.said if isinstance(one, RunChanged) and isinstance(one.fact, TaskOver)]
    reason = "left is no robot of the fleet any more, and was asked for it before: nobody hears what became of it"
    assert [(fact.outcome, fact.message) for fact in over] == [(TaskOutcome.UNKNOWN, reason)]
    assert world.mistakes.text() == ""
