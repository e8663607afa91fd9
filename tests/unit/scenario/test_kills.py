"""A process that is killed between any two writes of its journal comes back and goes on, and nothing is done twice."""

from __future__ import annotations

from collections import Counter
from functools import partial
from random import Random

import pytest

from tests.unit.scenario.owner import Killed, Owner, Skill
from ua_fleet.scenario.facts import TaskAnswered, TaskOutcome, TaskOver, Then

SCENARIO = """\
version: 1
name: nine_tasks
steps:
  - {task: box, robot: ridgeback, skill: bring}
  - parallel:
      - - {task: belt, robot: conveyor, skill: run}
        - {task: grasp, robot: ur3, skill: grasp}
      - {task: look, capacity: fly, skill: look, after: [belt]}
  - if: temperature > 20
    then: {task: left, robot: ur3, skill: turn, retries: 2}
    else: {task: right, robot: ur3, skill: turn, retries: 2}
  - repeat:
      - {task: blink, robot: lamp, skill: blink}
      - wait: 0.5
    times: 3
  - {task: home, robot: ridgeback, skill: go}
"""


def world() -> Owner:
    made = Owner(SCENARIO)
    made.values["temperature"] = 25
    made.any_robot["fly"] = "drone"
    made.skills["ridgeback", "go"] = Skill(outcome=TaskOutcome.FAILED)
    made.stand_in = lambda decision: "pioneer"
    return made


EXPECTED = Counter(
    [
        *[("box", "ridgeback"), ("belt", "conveyor"), ("grasp", "ur3"), ("look", "drone"), ("left", "ur3")],
        *[("blink", "lamp")] * 3,
        ("home", "pioneer"),
    ]
)


def run_with_kills(made: Owner, writes: list[int]) -> None:
    for count in writes:
        made.writes_left = count
        try:
            made.go()
        except Killed:
            made.restart()
    made.writes_left = None
    for _ in range(3):
        made.go()


def test_without_a_kill() -> None:
    made = world()
    made.go()
    assert made.log[-1].endswith("done")
    assert Counter(made.done_by) == EXPECTED


def test_a_kill_before_each_single_write() -> None:
    undisturbed = world()
    undisturbed.go()
    for place in range(len(undisturbed.journal)):
        made = world()
        run_with_kills(made, [place])
        assert made.ended, place
        assert Counter(made.done_by) == EXPECTED, place
        assert made.begun["home"] == 2, place


@pytest.mark.parametrize("block", range(10))
def test_a_thousand_runs_with_kills_at_random_moments(block: int) -> None:
    for seed in range(block * 100, block * 100 + 100):
        random = Random(seed)
        made = world()
        run_with_kills(made, [random.randrange(12) for _ in range(random.randrange(1, 12))])
        assert made.ended, seed
        assert Counter(made.done_by) == EXPECTED, seed


FORGETFUL = """\
version: 1
name: forgetful
steps:
  - {task: box, robot: ridgeback, skill: bring, on_unknown: replace}
  - parallel:
      - - {task: belt, robot: conveyor, skill: run, on_unknown: retry}
        - {task: grasp, robot: ur3, skill: grasp, on_unknown: retry}
      - {task: look, capacity: fly, skill: look, after: [belt], on_unknown: ask}
  - repeat:
      - {task: blink, robot: lamp, skill: blink, on_unknown: ask}
    times: 3
  - {task: home, robot: ridgeback, skill: go, on_unknown: replace}
"""
TASKS = Counter({"box": 1, "belt": 1, "grasp": 1, "look": 1, "blink": 3, "home": 1})
ROBOTS = ("ridgeback", "conveyor", "ur3", "drone", "lamp", "pioneer")


def facts_of(made: Owner, outcome: TaskOutcome) -> list[TaskOver]:
    return [fact for fact in made.facts(TaskOver) if isinstance(fact, TaskOver) and fact.outcome is outcome]


def forgetful_run(seed: int) -> Counter[str]:
    """A run whose server and bridges are killed; what was told, and what became of it."""
    random = Random(seed)
    made = Owner(FORGETFUL)
    made.any_robot["fly"] = "drone"
    made.stand_in = lambda decision: "pioneer"
    made.answer = lambda question: random.choice(("done", "retry", "replace"))
    for _ in range(random.randrange(1, 6)):
        robot = random.choice(ROBOTS)
        made.at(random.uniform(0.0, 8.0), partial(made.kill_bridge, robot))
    run_with_kills(made, [random.randrange(12) for _ in range(random.randrange(1, 8))])
    assert made.ended, seed
    assert made.log[-1].endswith("done"), seed

    unknown, done = facts_of(made, TaskOutcome.UNKNOWN), facts_of(made, TaskOutcome.DONE)
    assert len(unknown) == len(made.unknowable), seed
    told = sum(made.begun.values())
    assert told == len(done) + len(unknown), seed
    answers = Counter(fact.then for fact in made.facts(TaskAnswered) if isinstance(fact, TaskAnswered))
    assert len(done) + answers[Then.DONE] == TASKS.total(), seed
    # The machine did each unknown one all the same, so that nothing is lost; done again is what was not taken for done.
    really = Counter(task for task, _ in made.done_by)
    assert not TASKS - really, seed
    assert really.total() - TASKS.total() == len(unknown) - answers[Then.DONE], seed
    return Counter(told=told, done=len(done), unknown=len(unknown)) + Counter(fact.then.value for fact in unknown)


@pytest.mark.parametrize("block", range(10))
def test_a_thousand_runs_with_robots_that_cannot_be_asked(block: int) -> None:
    counts: Counter[str] = Counter()
    for seed in range(block * 100, block * 100 + 100):
        counts += forgetful_run(seed)
    assert counts["told"] == counts["done"] + counts["unknown"]
    assert counts["unknown"] == counts["ask"] + counts["replace"], "a robot that cannot tell is not asked again unasked"
    assert min(counts["ask"], counts["replace"]) > 3, "what does not occur is not tested"


def test_these_tests_notice_what_is_done_twice() -> None:
    undisturbed = world()
    undisturbed.go()
    doubled = 0
    for place in range(len(undisturbed.journal)):
        made = world()
        made.robots_forget = True
        run_with_kills(made, [place])
        doubled += Counter(made.done_by) != EXPECTED
    assert doubled > 5
