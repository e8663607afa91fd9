"""Tasks that wait for a robot which another run has: what is said, and which of several robots a task takes."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.unit.orchestrator.world import World
from ua_fleet.orchestrator import Output, TaskStarted, TaskWaiting
from ua_fleet.resilience import DecisionMode
from ua_fleet.scenario.facts import TaskOutcome

GRAB = "  - {{task: {0}, robot: ridgeback, skill: grab}}\n"
ANY = "  - {{task: {0}, skill: go, capacity: mobile}}\n"


def waits(world: World, run_id: str) -> list[tuple[str, str, str]]:
    """What a run said of its tasks that wait: task, robot, reason."""
    told = [one for one in world.said if isinstance(one, TaskWaiting) and one.run_id == run_id]
    return [(one.waits.task, one.waits.robot, one.waits.reason) for one in told]


def robots(world: World) -> list[str]:
    return [f"{one.run_id} {one.robot}" for one in world.said if isinstance(one, TaskStarted)]


def test_a_task_whose_robot_another_run_has_says_so_until_it_begins() -> None:
    world = World()
    for run_id in "abc":
        world.start(run_id, GRAB.format(f"t_{run_id}"))
    at = "ridgeback does task t_a of run a; ua-fleet scenario abort a ends that run"
    assert waits(world, "a") == []
    assert waits(world, "b") == [("t_b", "ridgeback", at)]
    assert waits(world, "c") == [("t_c", "ridgeback", at)]
    world.take(world.make.poll(world.now))
    assert len(waits(world, "b")) == 1, "it is told once"
    world.go(1.5)
    assert waits(world, "c")[1:] == [
        ("t_c", "ridgeback", at.replace("t_a", "t_b").replace("run a", "run b").replace("abort a", "abort b"))
    ]
    world.go()
    assert world.log == [
        *("0 a ridgeback grab", "1 a done", "1 b ridgeback grab"),
        *("2 b done", "2 c ridgeback grab", "3 c done"),
    ]


def test_tasks_of_one_run_that_share_a_robot_say_nothing() -> None:
    world = World()
    world.start(
        "a", "  - parallel:\n    - - {task: x, robot: ur3, skill: grab}\n    - - {task: y, robot: ur3, skill: grab}\n"
    )
    world.go()
    assert world.log[-1] == "2 a done"
    assert waits(world, "a") == []


def test_a_task_that_waits_for_a_robot_of_which_nobody_knows_says_which_question_is_open() -> None:
    world = World(DecisionMode.OPERATOR)
    world.outcome["ridgeback", "grab"] = TaskOutcome.UNKNOWN
    world.start("a", GRAB.format("t1"))
    world.start("b", GRAB.format("t2"))
    world.go(2)
    (*_, (_, robot, reason)) = waits(world, "b")
    assert robot == "ridgeback"
    answer = "ua-fleet scenario answer a t1 done|retry|fail"
    assert reason == f"ridgeback may still be at task t1 of run a; say what became of it: {answer}"


def test_a_task_that_waits_for_a_robot_which_has_not_stopped_says_so() -> None:
    world = World(DecisionMode.OPERATOR)
    world.unstoppable.add("ridgeback")
    world.start("a", GRAB.format("t1").replace("}", ", timeout_s: 0.5}"))
    world.start("b", GRAB.format("t2"))
    world.go(0.6)
    assert waits(world, "b")[-1][2] == "ridgeback is to stop task t1 of run a; ua-fleet scenario abort a ends that run"
    world.take(world.make.abort("a", "enough", "anna", 0.7))
    assert waits(world, "b")[-1][2] == "ridgeback is to stop task t1 of run a, which ends"
    world.go(10.6)
    assert waits(world, "b")[-1][2] == "ridgeback is to stop task t1 of run a, which ends"


def test_a_run_that_is_paused_waits_for_no_robot_and_says_so_again_when_it_is_resumed() -> None:
    world = World()
    world.start("a", GRAB.format("t1"))
    world.start("b", GRAB.format("t2"))
    world.take(world.make.pause("b", "anna", 0))
    world.take(world.make.resume("b", "anna", 0))
    assert [reason[:24] for _, _, reason in waits(world, "b")] == 2 * ["ridgeback does task t1 o"]
    world.go()
    assert world.log[-1] == "2 b done"


def test_a_task_for_any_robot_takes_one_that_is_free_and_not_the_best_that_is_in_use() -> None:
    world = World()
    world.values["ridgeback.battery"] = 100.0
    world.start("a", ANY.format("t1"))
    world.start("b", ANY.format("t2"))
    world.start("c", ANY.format("t3"))
    assert robots(world)[0] == "a ridgeback"
    assert {line.split()[1] for line in robots(world)} == {"ridgeback", "pioneer_1", "pioneer_2"}
    assert not waits(world, "b")
    assert not waits(world, "c")


def test_tasks_of_one_run_for_any_robot_are_done_side_by_side() -> None:
    world = World()
    world.values["ridgeback.battery"] = 100.0
    world.start("a", "  - parallel:\n    - -" + ANY.format("x")[3:] + "    - -" + ANY.format("y")[3:])
    assert len(set(robots(world))) == 2


def test_where_none_is_free_it_says_so_and_takes_the_first_that_is() -> None:
    world = World()
    for number, robot in enumerate(("ridgeback", "pioneer_1", "pioneer_2")):
        world.values[f"{robot}.battery"] = 100.0 - 30 * number
        world.start(robot, f"  - {{task: t, robot: {robot}, skill: go}}\n")
    world.start("any", ANY.format("t"))
    (told,) = waits(world, "any")
    assert told[:2] == ("t", "")
    assert "does task t of run" in told[2]
    started = next(one for one in world.said if isinstance(one, TaskStarted) and one.robot == "pioneer_2")
    world.take(world.make.ended(started.execution_id, TaskOutcome.DONE, 0.5))
    assert robots(world)[-1] == "any pioneer_2", "the worst of them, but it is free"
    world.go()
    assert "1 any done" in world.log or "1.5 any done" in world.log, world.log


@pytest.mark.parametrize("how", ["fault", "hold", "silence"])
def test_where_none_is_free_it_takes_one_that_can_work_again(how: str) -> None:
    world = World()
    make = world.make
    begin: Callable[[], list[Output]] = {
        "fault": lambda: make.fault_raised("pioneer_2", "robot", "hot", 0),
        "hold": lambda: make.hold("pioneer_2", "anna", "", 0),
        "silence": lambda: make.fault_raised("pioneer_2", "silent", "it is silent", 0),
    }[how]
    end: Callable[[], list[Output]] = {
        "fault": lambda: make.fault_cleared("pioneer_2", "robot", 0.5),
        "hold": lambda: make.release("pioneer_2", "anna", 0.5),
        "silence": lambda: make.fault_cleared("pioneer_2", "silent", 0.5),
    }[how]
    world.take(begin())
    for robot in ("ridgeback", "pioneer_1"):
        world.start(robot, f"  - {{task: t, robot: {robot}, skill: go}}\n")
    world.start("any", ANY.format("t"))
    assert len(robots(world)) == 2
    world.take(end())
    assert robots(world)[-1] == "any pioneer_2"
