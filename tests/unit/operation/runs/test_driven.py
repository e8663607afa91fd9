"""Robots that people drive by hand: waited for as those that are held, and nothing of it stands in the journal."""

from __future__ import annotations

from pathlib import Path

from tests.unit.nodes.test_partial_faults import CONFIG as ABLE
from tests.unit.operation.runs.test_people_at_robots import ANY, asked, waiting
from tests.unit.operation.runs.world import ACCEPTED, World
from ua_fleet.orchestrator import DecisionChanged
from ua_fleet.scenario.consequences import BUSY_S

DRIVEN = "is driven by hand by anna"


def test_a_driven_robot_is_waited_for_and_the_run_says_who_drives_it(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.service.driven("left", DRIVEN)
    world.start()
    world.pass_time(BUSY_S - 1)
    assert asked(world) == []
    assert waiting(world) == [("left", f"left {DRIVEN}")]
    world.service.driven("left", "")
    assert asked(world) == ["left"]


def test_after_so_long_another_robot_takes_the_task(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.service.driven("left", DRIVEN)
    world.start()
    world.pass_time(BUSY_S + 1)
    assert asked(world) == ["right"]
    (decision, *_) = [one for one in world.said if isinstance(one, DecisionChanged)]
    assert decision.reason == f"left {DRIVEN}; it was waited for 10 s"


def test_any_robot_is_none_that_is_driven(tmp_path: Path) -> None:
    world = World(tmp_path, config=ABLE)
    world.service.driven("left", DRIVEN)
    world.start(ANY)
    assert asked(world) == ["right"]


def test_what_a_robot_is_at_goes_on(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start()
    world.service.concluded(world.robots.asked[0][2], ACCEPTED)
    world.service.driven("left", "is being stopped, since it was driven by hand")
    world.pass_time(3)
    assert (asked(world), world.robots.halted) == (["left"], [])


def test_it_is_nobodys_hold_and_leaves_that_of_others_alone(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.service.holds.hold("left", "", "otto")
    world.service.driven("left", DRIVEN)
    world.service.driven("left", "")
    world.start()
    world.pass_time(1)
    assert asked(world) == []
    assert "left is held by otto" in waiting(world)[0][1]
    world.service.holds.release("left", "otto")
    assert asked(world) == ["left"]
