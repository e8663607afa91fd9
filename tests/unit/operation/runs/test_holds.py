"""Robots that people hold back from tasks: waited for as those in use are, over restarts, and told of."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.nodes.test_partial_faults import CONFIG as ABLE
from tests.unit.operation.runs.test_people_at_robots import ANY, TWO, asked, waiting
from tests.unit.operation.runs.world import ACCEPTED, CONFIG, IMMEDIATE, World
from ua_fleet.errors import ScenarioError, StorageUnavailable
from ua_fleet.operation.runs.library import ScenarioUnknown
from ua_fleet.orchestrator import DecisionChanged, Hold, HoldChanged
from ua_fleet.resilience import DecisionMode, RankingChanged, ReplacementChosen
from ua_fleet.scenario.consequences import BUSY_S

SAID = "left is held by anna since 1970-01-01 00:01:40 UTC (new tyre); when it may have tasks again, run: "
COMMAND = "ua-fleet robot release left"


def changes(world: World) -> list[tuple[str, bool, str]]:
    return [(one.hold.robot, one.is_held, one.by) for one in world.said if isinstance(one, HoldChanged)]


def test_a_held_robot_is_waited_for_and_the_run_says_who_holds_it(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.service.holds.hold("left", " new\n tyre ", "anna")
    world.start()
    world.pass_time(BUSY_S - 1)
    assert asked(world) == []
    assert waiting(world) == [("left", SAID + COMMAND)]
    world.service.holds.release("left", "otto")
    assert asked(world) == ["left"]
    assert changes(world) == [("left", True, "anna"), ("left", False, "otto")]


def test_after_so_long_another_robot_takes_the_task(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.service.holds.hold("left", "new tyre", "anna")
    world.start()
    world.pass_time(BUSY_S + 1)
    assert asked(world) == ["right"]
    (decision, *_) = [one for one in world.said if isinstance(one, DecisionChanged)]
    assert decision.reason == f"{SAID}{COMMAND}; it was waited for 10 s"
    assert world.faults() == []


def test_where_nobody_else_can_the_first_robot_has_it_back_when_it_is_released(tmp_path: Path) -> None:
    resilience = CONFIG.resilience.model_copy(update={"mode": DecisionMode.OPERATOR})
    world = World(tmp_path, config=CONFIG.model_copy(update={"resilience": resilience}))
    world.service.holds.hold("left", "", "anna")
    world.service.fault_reports.raise_fault("right", "hot")
    world.start()
    world.pass_time(BUSY_S + 1)
    assert asked(world) == []
    world.service.holds.release("left", "anna")
    assert asked(world) == ["left"]
    chosen = [one.event for one in world.said if isinstance(one, DecisionChanged)][-1]
    assert isinstance(chosen, ReplacementChosen)
    assert chosen.by == "back"


def test_what_a_robot_is_at_goes_on_and_its_next_task_waits(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.start(TWO)
    world.service.concluded(world.robots.asked[0][2], ACCEPTED)
    world.service.holds.hold("left", "", "anna")
    world.pass_time(3)
    assert (asked(world), world.robots.halted) == (["left"], [])
    world.service.concluded(world.robots.asked[0][2], IMMEDIATE)
    world.pass_time(BUSY_S - 1)
    assert asked(world) == ["left"]
    world.service.holds.release("left", "anna")
    assert asked(world) == ["left", "left"]


def test_any_robot_is_none_that_is_held(tmp_path: Path) -> None:
    world = World(tmp_path, config=ABLE)
    world.service.holds.hold("left", "", "anna")
    world.start(ANY)
    assert asked(world) == ["right"]


def test_a_held_robot_takes_nothing_over_and_the_ranking_says_why(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.service.holds.hold("right", "new tyre", "anna")
    world.service.fault_reports.raise_fault("left", "hot")
    world.start()
    world.pass_time(1)
    events = [one.event for one in world.said if isinstance(one, DecisionChanged)]
    (ranking,) = [event.ranking for event in events if isinstance(event, RankingChanged)][-1:]
    reasons = {one.robot: one.reason for one in ranking.excluded}
    assert reasons["right"] == "is held by anna since 1970-01-01 00:01:40 UTC (new tyre)"
    world.service.holds.release("right", "anna")
    assert asked(world) == ["right"]


def test_a_hold_outlasts_the_server(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.service.holds.hold("left", "new tyre", "anna")
    world.journal.close()
    world = World(tmp_path)
    assert list(world.service.holds) == [Hold("left", "anna", 100.0, "new tyre")]
    assert changes(world) == [], "nothing has happened"
    world.start()
    assert asked(world) == []
    world.service.holds.release("left", "anna")
    world.journal.close()
    assert list(World(tmp_path).service.holds) == []


def test_who_holds_a_robot_may_say_another_reason_and_nobody_else_takes_it(tmp_path: Path) -> None:
    world = World(tmp_path)
    holds = world.service.holds
    holds.hold("left", "tyre", "anna")
    world.now += 60
    holds.hold("left", "brakes", "anna")
    holds.hold("left", "brakes", "anna")
    assert list(holds) == [Hold("left", "anna", 100.0, "brakes")]
    assert len(changes(world)) == 2
    with pytest.raises(ScenarioError, match=r"left is held by anna since .* \(brakes\).*release left; then hold it"):
        holds.hold("left", "mine", "otto")
    with pytest.raises(ScenarioUnknown, match="there is no robot 'lefd'"):
        holds.hold("lefd", "", "otto")
    with pytest.raises(ScenarioError, match="right is not held"):
        holds.release("right", "otto")
    holds.hold("right", "x" * 1000, "otto")
    assert [len(one.reason) for one in holds] == [6, 200]


def test_what_cannot_be_written_down_is_said_and_written_later(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.journal.fails = True
    with pytest.raises(StorageUnavailable):
        world.service.holds.hold("left", "", "anna")
    assert changes(world) == []
    world.journal.fails = False
    world.pass_time(2)
    assert changes(world) == [("left", True, "anna")]
    assert [hold.robot for hold in world.journal.holds()] == ["left"]
