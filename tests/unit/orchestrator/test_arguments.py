"""A task is asked of each robot in that robot's own units and with its own defaults."""

from __future__ import annotations

import pytest

from ua_fleet.fleet.skills import ArgumentModel, SkillModel
from ua_fleet.orchestrator import DecisionChanged, Orchestrator, Output, ResilienceSettings, TasksAhead, TaskStarted
from ua_fleet.resilience import Criterion, CriterionKind, DecisionMode, RankingChanged
from ua_fleet.scenario import FleetView, RobotView, scenario_of, validate
from ua_fleet.scenario.consequences import SETTLE_S
from ua_fleet.values import BuiltinType

FREE = Criterion("availability", CriterionKind.BENEFIT, (0, 100))
SETTINGS = ResilienceSettings(((FREE, TasksAhead()),), {}, mode=DecisionMode.AUTOMATIC)


def turn(unit: str, *more: ArgumentModel, limit: float = 360) -> SkillModel:
    angle = ArgumentModel("angle", BuiltinType.DOUBLE, unit, (-limit, limit))
    return SkillModel(1, "turn", ("grab",), (angle, *more))


SPEED = ArgumentModel("speed", BuiltinType.DOUBLE, "deg/s", default=10)
TOOL = ArgumentModel("tool", BuiltinType.STRING)


def start(robot: str, **skills: SkillModel) -> tuple[Orchestrator, list[Output]]:
    """A run of one task, with robots of these names and skills."""
    robots = {name: RobotView(name, frozenset({"grab"}), {"turn": skill}) for name, skill in skills.items()}
    make = Orchestrator(SETTINGS, FleetView(robots), lambda _: 0.0, lambda _run, _fact: None)
    text = f"version: 1\nname: s\nsteps:\n  - {{task: t, {robot}, skill: turn, arguments: {{angle: 20 deg}}}}\n"
    checked = validate(scenario_of(text), FleetView(robots))
    assert checked.problems == ()
    return make, make.start("a", checked.scenario, {}, by="anna", now=0.0)


def asked(outputs: list[Output]) -> list[tuple[str, dict[str, object]]]:
    return [(each.robot, dict(each.arguments)) for each in outputs if isinstance(each, TaskStarted)]


def test_a_replacement_is_asked_in_its_own_units_and_with_its_own_defaults() -> None:
    make, begun = start("robot: left", left=turn("deg"), right=turn("rad", SPEED))
    assert asked(begun) == [("left", {"angle": 20.0})]
    make.fault_raised("left", "announced", "stuck", 1.0)
    outputs = make.poll(1.0 + SETTLE_S)
    assert asked(outputs) == [("right", {"angle": pytest.approx(0.349066), "speed": 10})]


def test_any_robot_is_asked_in_its_own_units() -> None:
    make, begun = start("capacity: grab", left=turn("deg", SPEED), right=turn("rad"))
    assert asked(begun) == [("left", {"angle": 20.0, "speed": 10})]
    make.fault_raised("left", "announced", "stuck", 1.0)
    outputs = make.poll(1.0 + SETTLE_S)
    assert asked(outputs) == [("right", {"angle": pytest.approx(0.349066)})]


def test_a_robot_that_the_arguments_do_not_fit_is_no_candidate_and_says_so() -> None:
    others = {"metres": turn("m"), "needy": turn("deg", TOOL), "stiff": turn("deg", limit=10)}
    make, _ = start("robot: left", left=turn("deg"), **others)
    make.fault_raised("left", "announced", "stuck", 1.0)
    outputs = make.poll(1.0 + SETTLE_S)
    assert asked(outputs) == []
    events = [each.event for each in outputs if isinstance(each, DecisionChanged)]
    ranking = next(event.ranking for event in events if isinstance(event, RankingChanged))
    said = {left.robot: left.reason for left in ranking.excluded}
    assert "angle" in said["metres"]
    assert "'tool' of turn is missing" in said["needy"]
    assert "legal is -10 to 10 deg" in said["stiff"]
