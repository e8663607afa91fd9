"""The time of runs: no clock that is set moves it, also where it is behind at a restart."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.operation.runs.world import ACCEPTED, ONE, Robots, World
from ua_fleet.operation.runs.clock import steady
from ua_fleet.scenario.consequences import HALT_S

WAIT = "version: 1\nname: w\nsteps:\n  - {wait: 5}\n  - {task: a, skill: grab, robot: left}\n"
BEHIND_S = 3600.0


def test_a_wall_clock_that_is_set_moves_nothing() -> None:
    monotonic, wall = [5.0], [1_000.0]
    clock = steady(lambda: monotonic[0], lambda: wall[0])
    assert clock() == 1_000.0
    monotonic[0] += 2.5
    wall[0] += 3_600.0
    assert clock() == 1_002.5


def test_one_that_is_behind_goes_on_from_what_was_written_down() -> None:
    monotonic = [5.0]
    clock = steady(lambda: monotonic[0], lambda: 1_000.0)
    assert (clock.go_on_from(900.0), clock()) == (0.0, 1_000.0)
    assert (clock.go_on_from(1_500.0), clock()) == (500.0, 1_500.0)
    monotonic[0] += 1.0
    assert clock() == 1_501.0


def later_world(folder: Path) -> World:
    """Its clock is ahead of that of the next one."""
    world = World(folder)
    world.pass_time(BEHIND_S)
    return world


def restarted(folder: Path, world: World) -> World:
    """A server whose clock stands where it was an hour ago."""
    world.journal.close()
    robots = Robots()
    robots.known = world.robots.known
    return World(folder, robots)


def test_a_wait_goes_on_with_what_is_left_of_it(tmp_path: Path) -> None:
    world = later_world(tmp_path)
    world.start(WAIT)
    world.pass_time(2)
    world = restarted(tmp_path, world)
    world.pass_time(4)
    assert world.robots.asked == []
    world.pass_time(1.5)
    assert [robot for robot, *_ in world.robots.asked] == ["left"]


def test_a_robot_is_told_to_stop_at_the_time_out_of_its_task(tmp_path: Path) -> None:
    world = later_world(tmp_path)
    world.start(ONE)
    world.service.concluded(world.robots.asked[0][2], ACCEPTED)
    world = restarted(tmp_path, world)
    world.pass_time(4)
    assert world.robots.halted == []
    world.pass_time(2)
    assert set(world.robots.halted) == {"left"}


def test_an_aborted_run_ends_and_people_are_asked_of_a_halt_that_nobody_confirms(tmp_path: Path) -> None:
    world = later_world(tmp_path)
    run_id = world.start(ONE)
    world.service.concluded(world.robots.asked[0][2], ACCEPTED)
    world.service.runs.abort(run_id, "enough", "anna")
    world = restarted(tmp_path, world)
    assert world.service.run_ids == [run_id]
    world.pass_time(HALT_S + 1)
    assert world.service.run_ids == []
    assert [fault.id for fault in world.service.faults] == ["left.not_halted"]


def test_a_clock_that_is_ahead_counts_what_has_passed_and_nothing_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    world = World(tmp_path)
    world.start(WAIT)
    world.journal.close()
    later = World(tmp_path, began=200.0)
    later.pass_time(0.1)
    assert [robot for robot, *_ in later.robots.asked] == ["left"]
    assert "the clock is behind" not in capsys.readouterr().out


def test_that_it_is_behind_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    world = later_world(tmp_path)
    world.start(WAIT)
    restarted(tmp_path, world)
    assert "the clock is behind what runs wrote down last" in capsys.readouterr().out
