"""What a run would come to, without robots; and that it would come to that."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from typing import cast

import pytest
from hypothesis import given
from hypothesis import settings as settings_of_hypothesis
from hypothesis import strategies as st

from tests.unit.orchestrator.world import FLEET as MOBILE
from tests.unit.orchestrator.world import World, settings
from ua_fleet.errors import ScenarioError
from ua_fleet.fleet.skills import ArgumentModel, SkillModel
from ua_fleet.orchestrator import RunChanged
from ua_fleet.orchestrator.dry_run import DryRun, dry_run
from ua_fleet.scenario import FleetView, RobotView, Value, scenario_of, validate
from ua_fleet.scenario.facts import RunOutcome, TaskAssigned
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
    return dry_run(checked.scenario, FLEET, settings(), parameters, values)


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


def assigned(world: World) -> list[tuple[str, str]]:
    facts = [said.fact for said in world.said if isinstance(said, RunChanged)]
    return [(fact.task, fact.robot) for fact in facts if isinstance(fact, TaskAssigned)]


def rehearsed(run: DryRun) -> list[tuple[str, str]]:
    texts = [moment.text.split() for moment in run.timeline if ": " in moment.text and "(" in moment.text]
    return [(words[0].rstrip(":"), words[1]) for words in texts]


def test_three_tasks_side_by_side_go_to_three_robots_as_in_the_run() -> None:
    steps = "  - parallel:\n" + "".join(f"      - {{task: t{n}, capacity: mobile, skill: go}}\n" for n in range(3))
    world = World()
    world.start("a", steps)
    world.go()
    run = dry_run(scenario_of(f"version: 1\nname: s\nsteps:\n{steps}"), MOBILE, settings(), lookup=world.lookup)
    assert len({robot for _, robot in assigned(world)}) == 3
    assert rehearsed(run) == assigned(world)


_TASKS = st.tuples(
    st.sampled_from(["capacity: mobile, skill: go", "capacity: grab, skill: grab", "robot: ridgeback, skill: grab"]),
    st.sampled_from(["", ", arguments: {to: dock}"]),
).map(lambda parts: parts[0] + (parts[1] if parts[0].endswith("go") else ""))
_SHAPES = st.recursive(
    _TASKS,
    lambda steps: st.tuples(st.sampled_from(["parallel", "sequence"]), st.lists(steps, min_size=2, max_size=4)),
    max_leaves=12,
)


def written(shape: object, numbers: Iterator[int]) -> object:
    """A shape as a step; each task with a name of its own."""
    if isinstance(shape, str):
        return f"{{task: t{next(numbers)}, {shape}}}"
    kind, steps = cast("tuple[str, list[object]]", shape)
    return f"{{{kind}: [{', '.join(str(written(step, numbers)) for step in steps)}]}}"


@settings_of_hypothesis(max_examples=150, deadline=None)
@given(
    _SHAPES,
    st.lists(st.floats(0, 100), min_size=4, max_size=4),
    st.lists(st.floats(0, 50), min_size=4, max_size=4),
    st.sets(st.sampled_from([f"{robot}.{value}" for robot in MOBILE.robots for value in ("battery", "x")])),
)
def test_whatever_goes_side_by_side_the_robots_are_those_of_the_run(
    shape: object, batteries: list[float], places: list[float], missing: set[str]
) -> None:
    world = World()
    for robot, battery, place in zip(MOBILE.robots, batteries, places, strict=True):
        world.values.update({f"{robot}.battery": battery, f"{robot}.x": place})
    for name in missing:
        del world.values[name]
    steps = f"  - {written(shape, count())}\n"
    world.start("a", steps)
    world.go()
    run = dry_run(scenario_of(f"version: 1\nname: s\nsteps:\n{steps}"), MOBILE, settings(), lookup=world.lookup)
    assert run.outcome is RunOutcome.DONE
    assert rehearsed(run) == assigned(world)


def test_values_that_are_not_given_are_those_of_now() -> None:
    steps = """
  - if: temperature > 20
    then: [{end: done, reason: warm}]
    else: [{end: done, reason: cold}]
"""
    checked = validate(scenario_of(f"version: 1\nname: s\nsteps:\n{steps}"), FLEET)
    for given_values, reason in (({}, "warm"), ({"temperature": 3.0}, "cold")):
        run = dry_run(checked.scenario, FLEET, settings(), {}, given_values, lookup=lambda _: 25.0)
        assert run.reason == reason
