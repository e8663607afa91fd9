"""What comes after what, also where it fails or is repeated, and what a run has ahead."""

from __future__ import annotations

import pytest

from tests.unit.scenario.owner import Killed, Owner, Skill
from ua_fleet.scenario.facts import TaskOutcome

HEAD = "version: 1\nname: s\nsteps:\n"
NED = "robot: ned, skill: pick"
DRONE = "robot: drone, skill: up"
LOST = "failed task a: pick on ned: failed; no robot is left that can take over"


def owner(steps: str) -> Owner:
    world = Owner(HEAD + steps)
    world.stand_in = lambda decision: None
    return world


def failing(steps: str) -> Owner:
    world = owner(steps)
    world.skills["ned", "pick"] = Skill(outcome=TaskOutcome.FAILED)
    return world


TASK = f"""
  - parallel:
      - {{task: b, {DRONE}, after: [a]}}
      - {{task: a, {NED}}}
"""
BRANCH = f"""
  - parallel:
      - - {{task: z, {DRONE}}}
        - {{task: b, {DRONE}, after: [c]}}
      - - {{task: a, {NED}}}
        - sequence: [{{task: c, {NED}}}]
"""
CHAIN = f"""
  - parallel:
      - {{task: b, {DRONE}, after: [c]}}
      - {{task: c, {DRONE}, after: [a]}}
      - {{task: a, {NED}}}
"""
FURTHER_IN = f"""
  - parallel:
      - {{task: b, {DRONE}, after: [a]}}
      - repeat:
          - parallel:
              - {{task: a, {NED}}}
              - {{task: c, {DRONE}, after: [b]}}
        times: 2
"""


@pytest.mark.parametrize("steps", [TASK, BRANCH, CHAIN, FURTHER_IN])
def test_a_task_after_one_that_is_not_done_fails(steps: str) -> None:
    world = failing(steps)
    world.go()
    assert [line.partition(" ")[2] for line in world.log if " up" not in line] == ["ned pick", LOST]
    assert "b" not in world.begun
    assert any(
        f"task b comes after {'c' if 'after: [c]' in steps else 'a'}, which was not" in fact for fact in world.journal
    )


@pytest.mark.parametrize("steps", [TASK, BRANCH, CHAIN, FURTHER_IN])
def test_also_with_a_kill_before_each_write(steps: str) -> None:
    undisturbed = failing(steps)
    undisturbed.go()
    for place in range(len(undisturbed.journal)):
        world = failing(steps)
        world.writes_left = place
        try:
            world.go()
        except Killed:
            world.restart()
        world.go()
        world.go()
        assert world.log[-1].endswith(LOST), place
        assert "b" not in world.begun, place


def test_what_may_still_be_done_is_waited_for() -> None:
    world = owner(TASK)
    world.stand_in = lambda decision: "ur3"
    world.skills["ned", "pick"] = Skill(outcome=TaskOutcome.FAILED)
    world.go()
    assert world.log == ["0 ned pick", "1 ur3 pick", "2 drone up", "3 done"]


def test_after_holds_in_each_repetition() -> None:
    world = owner(f"""
  - repeat:
      - repeat:
          - parallel:
              - {{task: a, {NED}}}
              - {{task: b, {DRONE}, after: [a]}}
        times: 2
    times: 2
""")
    world.skills["ned", "pick"] = Skill(takes_s=5)
    world.go()
    turns = [line for at in (0, 6, 12, 18) for line in (f"{at} ned pick", f"{at + 5} drone up")]
    assert world.log == [*turns, "24 done"]


def test_after_a_task_that_is_repeated_elsewhere_or_around_holds_from_its_first_time_on() -> None:
    world = owner(f"""
  - {{task: a, {NED}}}
  - parallel:
      - repeat: [{{task: b, {NED}}}]
        times: 2
      - repeat: [{{task: c, {DRONE}, after: [a, b]}}]
        times: 2
""")
    world.go()
    assert world.log == ["0 ned pick", "1 ned pick", "2 ned pick", "2 drone up", "3 drone up", "4 done"]


def test_a_long_repetition_keeps_no_more_than_it_needs() -> None:
    world = owner(f"""
  - repeat:
      - parallel:
          - {{task: a, {NED}}}
          - {{task: b, {DRONE}, after: [a]}}
    times: 1200
""")
    world.go(5000)
    assert world.begun == {"a": 1200, "b": 1200}
    assert world.run.state.tasks_done == {f"0.repeat.0.{n}.0{at}" for n in "01" for at in ("", "@1199")}


def ahead(world: Owner) -> list[str]:
    return [f"{robot or 'any'} {task.name}" for robot, task in world.run.ahead()]


def test_what_is_repeated_is_ahead_until_its_last_time() -> None:
    world = owner(f"""
  - repeat: [{{task: a, {NED}}}, {{task: b, {DRONE}}}]
    times: 3
  - {{task: c, capacity: x, skill: y}}
""")
    assert ahead(world) == ["ned a", "drone b", "any c"]
    world.go(3.5)
    assert world.log[-1] == "3 drone up"
    assert ahead(world) == ["drone b", "ned a", "any c"]
    world.go(4.5)
    assert ahead(world) == ["ned a", "drone b", "any c"]
    world.go(5.5)
    assert ahead(world) == ["drone b", "any c"]


@pytest.mark.parametrize(("temperature", "left"), [(None, ["ned a", "drone b", "ned c"]), (30, ["ned c"])])
def test_a_way_that_was_not_taken_is_not_ahead(temperature: float | None, left: list[str]) -> None:
    world = owner(f"""
  - if: temperature > 20
    then: [{{task: a, {NED}}}]
    else: [{{task: b, {DRONE}}}]
  - {{task: c, {NED}}}
""")
    if temperature is not None:
        world.values["temperature"] = temperature
    world.go(1.5)
    assert ahead(world) == left


def test_what_is_ahead_of_a_robot_is_with_the_last_that_stands_in() -> None:
    world = owner("".join(f"  - {{task: t{n}, {NED}}}\n" for n in range(3)))
    world.stand_in = lambda decision: {"ned": "ur3", "ur3": "drone"}[decision.robot]
    world.at(0.5, lambda: world.fault("ned", "hot"))
    world.at(0.7, lambda: world.fault("ur3", "hot"))
    world.go(1.1)
    assert ahead(world) == ["drone t0", "drone t1", "drone t2"]
