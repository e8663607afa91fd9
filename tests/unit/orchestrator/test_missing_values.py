"""Robots whose values are not known do what they alone can do."""

from __future__ import annotations

from tests.unit.orchestrator.world import World
from ua_fleet.orchestrator import RunChanged
from ua_fleet.resilience import RankingChanged
from ua_fleet.scenario.facts import TaskAssigned


def assigned(world: World) -> list[str]:
    facts = [said.fact for said in world.said if isinstance(said, RunChanged)]
    return [fact.robot for fact in facts if isinstance(fact, TaskAssigned)]


def test_the_only_robot_that_can_take_over_does_it_without_a_battery() -> None:
    """UR3 hangs on the mains, and has neither a battery nor a place."""
    world = World()
    for value in ("battery", "x", "y"):
        del world.values[f"ur3.{value}"]
    world.start("a", "  - {task: t, robot: ridgeback, skill: grab}\n")
    world.at(0.5, lambda: world.make.fault_raised("ridgeback", "announced", "the arm is hot", 0.5))
    world.go()
    assert assigned(world) == ["ridgeback", "ur3"]
    (ranking, *_) = [each.event.ranking for each in world.decisions() if isinstance(each.event, RankingChanged)]
    assert [place.robot for place in ranking.ranked] == ["ur3"]
    assert ranking.ranked[0].missing[0] == "battery is not known: ur3.battery is not known; it counts as the worst, 0 %"
    assert any(line.endswith(" a done") for line in world.log)


def test_who_has_no_battery_is_behind_who_has_one() -> None:
    world = World()
    del world.values["pioneer_1.battery"]
    world.values["pioneer_2.battery"] = 5.0
    for robot in ("pioneer_1", "pioneer_2"):
        world.values[f"{robot}.x"] = 1.0
    world.start("a", "  - {task: t, robot: ridgeback, skill: go}\n")
    world.at(0.5, lambda: world.make.fault_raised("ridgeback", "announced", "the drive is hot", 0.5))
    world.go()
    assert assigned(world) == ["ridgeback", "pioneer_2"]
