"""A task waits for the values of its arguments, which a restart of a bridge takes away for some seconds."""

from __future__ import annotations

from pathlib import Path

from tests.unit.operation.runs.world import ACCEPTED, ONE, Robots, World
from ua_fleet.fleet.model import RobotState
from ua_fleet.orchestrator import TaskWaiting
from ua_fleet.scenario.consequences import VALUE_S
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.skill.status import ExecutionStatus
from ua_fleet.values import BuiltinType, StatusCode

BATTERY = 1000
OF_RIGHT = ONE.replace("angle: 5", "angle: '=right.battery'")
OWN = ONE.replace("angle: 5", "angle: '=left.battery'")
LOST = int(StatusCode.BAD_NO_COMMUNICATION)
SILENCE_S = 30
FAILED = "failed task a: right.battery is not known now (BadNoCommunication)"


def lose(world: World, number: int) -> None:
    """The bridge of a robot is away."""
    world.value(BATTERY + number, None, status=LOST)
    world.silence(("left", "right")[number])


def asked(world: World) -> list[tuple[str, tuple[object, ...]]]:
    return [(robot, values) for robot, values, _ in world.robots.asked]


def waits(world: World) -> str:
    """What the last task waits for, as it was told last."""
    return [one.waits.reason for one in world.said if isinstance(one, TaskWaiting)][-1]


def test_a_task_waits_for_a_value_while_its_robot_is_silent_and_until_it_is_told(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.value(BATTERY + 1, 40.0)
    lose(world, 1)
    world.start(OF_RIGHT)
    world.pass_time(SILENCE_S - 1)
    assert (asked(world), world.ended()) == ([], [])
    assert waits(world) == "right.battery is not known now (BadNoCommunication)"
    world.state("right", RobotState.IDLE)
    world.pass_time(VALUE_S - 1)
    assert (asked(world), world.ended()) == ([], []), "the first source is heard before the others"
    world.value(BATTERY + 1, 41.0)
    world.pass_time(1)
    assert (asked(world), world.ended()) == ([("left", (41.0,))], [])


def test_it_waits_for_a_robot_that_is_silent_for_so_long(tmp_path: Path) -> None:
    world = World(tmp_path)
    lose(world, 1)
    world.start(OF_RIGHT)
    world.pass_time(SILENCE_S + 1)
    assert (asked(world), world.ended()) == ([], [FAILED])


def test_it_waits_for_so_long_for_what_a_robot_does_not_tell(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.value(BATTERY + 1, None, status=LOST)
    world.start(OF_RIGHT)
    world.pass_time(VALUE_S - 1)
    assert world.ended() == []
    world.pass_time(2)
    assert (asked(world), world.ended()) == ([], [FAILED])


def test_the_robot_that_is_to_do_it_may_be_the_one_whose_value_is_not_known(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.value(BATTERY, 40.0)
    lose(world, 0)
    world.start(OWN)
    world.pass_time(SILENCE_S - 1)
    world.state("left", RobotState.IDLE)
    world.pass_time(VALUE_S - 1)
    assert (asked(world), world.ended()) == ([], [])
    world.value(BATTERY, 42.0)
    world.pass_time(1)
    assert asked(world) == [("left", (42.0,))]


def test_it_waits_after_a_restart_of_the_server(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start(f"{ONE}  - {{task: b, skill: grab, robot: left, arguments: {{angle: '=right.battery'}}}}\n")
    ((*_, execution_id),) = world.robots.asked
    world.service.concluded(execution_id, ACCEPTED)
    world.journal.close()
    robots = Robots()
    robots.known[execution_id] = None
    again = World(tmp_path, robots)
    again.hear(1200, ExecutionStatus(execution_id, "grab", ExecutionState.DONE))
    again.pass_time(VALUE_S - 1)
    assert (asked(again), again.ended()) == ([], [])
    again.value(BATTERY + 1, 43.0)
    again.pass_time(1)
    assert (asked(again), again.ended()) == ([("left", (43.0,))], [])


def test_a_paused_run_waits_for_nothing(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.value(BATTERY + 1, None, BuiltinType.DOUBLE, LOST)
    run_id = world.start(OF_RIGHT)
    world.service.runs.pause(run_id, "anna")
    world.pass_time(2 * VALUE_S)
    world.service.runs.resume(run_id, "anna")
    world.pass_time(VALUE_S - 1)
    assert world.ended() == []
