"""What a run would come to, without robots."""

from __future__ import annotations

import pytest

from ua_fleet.errors import ScenarioError
from ua_fleet.fleet.skills import ArgumentModel, SkillModel
from ua_fleet.scenario import FleetView, RobotView, Value, scenario_of, validate
from ua_fleet.scenario.dry_run import DryRun, dry_run
from ua_fleet.scenario.facts import RunOutcome
from ua_fleet.values import BuiltinType

GRAB = SkillModel(
    1,
    "grab",
    arguments=(ArgumentModel("angle", int(BuiltinType.DOUBLE), default=0.0),),
    results=(ArgumentModel("weight", int(BuiltinType.DOUBLE)), ArgumentModel("what", int(BuiltinType.STRING))),
)
FLEET = FleetView(
    {"ur3": RobotView("ur3", frozenset({"grab"}), {"grab": GRAB})}, {"ur3.temperature": 1, "temperature": 1}
)


def rehearse(
    steps: str, parameters: dict[str, Value] | None = None, values: dict[str, Value] | None = None, head: str = ""
) -> DryRun:
    checked = validate(scenario_of(f"version: 1\nname: s\n{head}steps:\n{steps}"), FLEET)
    assert not checked.problems, checked.problems
    return dry_run(checked.scenario, FLEET, parameters, values)


def shown(run: DryRun) -> list[str]:
    return [f"{moment.at:g} {moment.text}" for moment in run.timeline]


def test_tasks_are_done_at_once_and_waits_take_their_time() -> None:
    run = rehearse(
        """
  - {task: one, skill: grab, robot: ur3, arguments: {angle: 5}}
  - {wait: 30}
  - {task: two, skill: grab, capacity: grab}
"""
    )
    assert run.outcome is RunOutcome.DONE
    assert shown(run) == [
        "0 one: ur3 grab(angle=5)",
        "0 done",
        "30 two: ur3 grab(angle=0.0)",
        "30 done",
        "30 the run is done",
    ]


def test_conditions_go_by_the_given_values_and_results() -> None:
    steps = """
  - {task: one, skill: grab, robot: ur3}
  - if: one.weight > limit and temperature < 50
    then: [{task: heavy, skill: grab, robot: ur3}]
    else: [{end: failed, reason: too light}]
"""
    head = "parameters: {limit: {default: 2}}\n"
    heavy = rehearse(steps, {"limit": 1}, {"one.weight": 1.5, "temperature": 20}, head)
    assert heavy.outcome is RunOutcome.DONE
    light = rehearse(steps, {}, {"one.weight": 1.5, "temperature": 20}, head)
    assert (light.outcome, light.reason) == (RunOutcome.FAILED, "too light")


def test_a_value_that_was_not_given_is_named() -> None:
    run = rehearse("  - {if: temperature > 20, then: [{wait: 1}]}")
    assert run.outcome is RunOutcome.FAILED
    assert "no value is given for temperature" in run.reason


def test_events_happen_when_they_are_waited_for() -> None:
    run = rehearse("  - {wait: null, event: door_open}")
    assert run.outcome is RunOutcome.DONE
    assert "0 event door_open" in shown(run)


def test_what_would_never_end_is_said() -> None:
    waiting = rehearse("  - {wait: null, until: temperature > 20}", values={"temperature": 10})
    assert waiting.outcome is None
    assert "wait for ever" in waiting.reason
    endless = rehearse(
        "  - {repeat: [{task: one, skill: grab, robot: ur3}], while: temperature > 20}", values={"temperature": 30}
    )
    assert endless.outcome is None
    assert "cut off" in endless.reason


def test_parameters_are_checked() -> None:
    with pytest.raises(ScenarioError, match="there is no parameter 'other'"):
        rehearse("  - {wait: 1}", {"other": 1})


def test_a_task_without_a_timeout_has_that_of_its_skill() -> None:
    checked = validate(scenario_of("version: 1\nname: s\nsteps:\n  - {task: a, skill: grab, robot: ur3}\n"), FLEET)
    (task,) = checked.scenario.tasks()
    assert task.timeout_s == GRAB.timeout_s
