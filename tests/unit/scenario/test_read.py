"""A scenario's file: what it comes to, and every mistake with its line."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.errors import ScenarioInvalid
from ua_fleet.scenario.expression import Expression
from ua_fleet.scenario.model import (
    Condition,
    End,
    EndOutcome,
    OnTimeout,
    OnUnknown,
    Parallel,
    Repeat,
    Task,
    Wait,
)
from ua_fleet.scenario.read import read_scenario, scenario_of

BOX = """\
version: 1
name: box_to_ridgeback
description: Carries a box
parameters:
  angle: {default: 20, unit: deg, range: [-90, 90]}
  site: hall2
  deadline_s:
steps:
  - task: fetch
    robot: ridgeback
    skill: bring_box
    arguments: {from: table_1, turn: -20 deg, speed: =angle / 2}
    timeout_s: 30
    retries: 2
    on_unknown: retry
  - parallel:
      - {task: fly, robot: drone, skill: take_off}
      - - task: measure
          capacity: temperature
          skill: measure
        - if: temperature > 20 and measure.value < 90
          then: {task: left, robot: ur3, skill: turn, arguments: {angle: 20 deg}}
          else:
            - {task: right, robot: ur3, skill: turn, arguments: {angle: -20 deg}}
  - repeat:
      - {task: blink, capacities: [light, sound], skill: blink, after: [fly]}
    times: 3
    while: gate.open
  - wait: 2.5
  - wait:
    until: box.count >= 1
    timeout_s: 60
    on_timeout: continue
  - {wait: , event: BoxArrived}
  - {end: failed, reason: for a test}
"""


def test_a_scenario_comes_to_its_steps() -> None:
    scenario = scenario_of(BOX)
    assert (scenario.name, scenario.description) == ("box_to_ridgeback", "Carries a box")
    angle, site, deadline = scenario.parameters
    assert (angle.default, angle.unit, angle.range, angle.required) == (20, "deg", (-90, 90), False)
    assert (site.default, deadline.required) == ("hall2", True)
    fetch, parallel, repeat, pause, until, event, end = scenario.body.steps
    assert isinstance(fetch, Task)
    assert (fetch.key, fetch.line, fetch.robot, fetch.skill) == ("0", 9, "ridgeback", "bring_box")
    assert (fetch.arguments["from"], fetch.arguments["turn"]) == ("table_1", "-20 deg")
    assert fetch.quantities == {"turn": (-20.0, "deg")}
    assert isinstance(fetch.arguments["speed"], Expression)
    assert fetch.arguments["speed"].names == {"angle"}
    assert (fetch.timeout_s, fetch.retries, fetch.on_unknown) == (30, 2, OnUnknown.RETRY)
    assert isinstance(parallel, Parallel)
    assert [len(branch.steps) for branch in parallel.branches] == [1, 2]
    condition = parallel.branches[1].steps[1]
    assert isinstance(condition, Condition)
    assert condition.when.names == {"temperature", "measure.value"}
    assert isinstance(repeat, Repeat)
    assert (repeat.times, repeat.while_ is not None) == (3, True)
    assert isinstance(pause, Wait)
    assert pause.for_s == 2.5
    assert isinstance(until, Wait)
    assert until.until is not None
    assert (until.timeout_s, until.on_timeout) == (60, OnTimeout.CONTINUE)
    assert isinstance(event, Wait)
    assert event.event == "BoxArrived"
    assert isinstance(end, End)
    assert (end.outcome, end.reason) == (EndOutcome.FAILED, "for a test")
    assert [task.name for task in scenario.tasks()] == ["fetch", "fly", "measure", "left", "right", "blink"]
    blink = list(scenario.tasks())[-1]
    assert (blink.capacities, blink.after) == (("light", "sound"), ("fly",))


def test_keys_are_unique_and_stable() -> None:
    keys = [step.key for step in scenario_of(BOX).steps()]
    assert len(keys) == len(set(keys))
    assert [task.key for task in scenario_of(BOX).tasks()] == [
        *("0", "1.0.0", "1.1.0"),
        *("1.1.1.then.0", "1.1.1.else.0", "2.repeat.0"),
    ]


def test_json_is_read_as_well() -> None:
    data: dict[str, Any] = {
        "version": 1,
        "name": "s",
        "steps": [{"task": "a", "robot": "r", "skill": "k", "arguments": {"n": 1.5}}],
    }
    (task,) = scenario_of(json.dumps(data, indent=1)).tasks()
    assert task.arguments == {"n": 1.5}


HEAD = "version: 1\nname: s\nsteps:\n"
TASK = "{task: a, robot: r, skill: k}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", ["F: is empty"]),
        ("name: s\nsteps: [" + TASK + "]", ["F:version: this program reads version 1"]),
        ("version: 0\nname: s\nsteps: [" + TASK + "]", ["F:1:version: this program reads version 1"]),
        (
            "version: 2\nnew: s\nsteps: [{dance: 1}]",
            ["F:1:version: this file has version 2, and this ua-fleet reads version 1; upgrade ua-fleet"],
        ),
        ("version: 1\nsteps: [" + TASK + "]", ["F:name: `name` is missing"]),
        ("version: 1\nname: 1a\nsteps: [" + TASK + "]", ["F:2:name: a name begins with a letter"]),
        ("version: 1\nname: s\n", ["F:steps: a scenario has at least one step"]),
        (
            "version: 1\nname: s\nstep: []\nsteps: [" + TASK + "]",
            ["F:3:step: unknown key `step`; did you mean `steps`?"],
        ),
        (HEAD + "  - just text\n", ["F:4:steps[0]: is no step; a step begins with one of `task`"]),
        (HEAD + "  - {skill: k}\n", ["F:4:steps[0]: the step is of no kind"]),
        (HEAD + "  - {task: a, end: done}\n", ["F:4:steps[0]: the step is `task` and `end` at once"]),
        (HEAD + "  - {task: a, robot: r}\n", ["F:4:steps[0].skill: `skill` is missing"]),
        (HEAD + "  - {task: a, skill: k}\n", ["F:4:steps[0]: task 'a' needs either a `robot` or a `capacity`"]),
        (HEAD + "  - {task: a, robot: r, capacity: c, skill: k}\n", ["needs either a `robot` or a `capacity`"]),
        (HEAD + "  - {task: a b, robot: r, skill: k}\n", ["'a b': a task's name has letters"]),
        (HEAD + f"  - {TASK}\n  - {TASK}\n", ["F:5:steps[1].task: there is a task 'a' in line 4 already"]),
        (HEAD + "  - {task: a, robot: r, skill: k, retries: -1}\n", ["whole number from 0 to 100"]),
        (
            HEAD + "  - {task: a, robot: r, skill: k, timeout_s: 0}\n",
            ["`timeout_s` must be a number of seconds above 0"],
        ),
        (HEAD + "  - {task: a, robot: r, skill: k, on_unknown: rety}\n", ["did you mean `retry`?"]),
        (HEAD + "  - {task: a, robot: r, skill: k, arguments: [1]}\n", ["arguments are names with values"]),
        (HEAD + "  - {task: a, robot: r, skill: k, arguments: {x: [1]}}\n", ["an argument is a number, a text"]),
        (HEAD + "  - {task: a, robot: r, skill: k, arguments: {x: =open()}}\n", ["no call here"]),
        (HEAD + "  - {task: a, robot: r, skill: k, after: 3}\n", ["`after` must be a list of names"]),
        (
            HEAD + "  - {task: a, robot: r, skill: k, timout_s: 3}\n",
            ["unknown key `timout_s`; did you mean `timeout_s`?"],
        ),
        (HEAD + "  - parallel: [" + TASK + "]\n", ["F:4:steps[0].parallel: side by side are at least two"]),
        (
            HEAD + "  - if: temperature >\n    then: " + TASK + "\n",
            ["F:4:steps[0].if: 'temperature >' is no condition"],
        ),
        (HEAD + "  - if: a > 1\n", ["this condition has no steps"]),
        (HEAD + "  - repeat: " + TASK + "\n", ["would repeat for ever"]),
        (HEAD + "  - {repeat: [], times: 2}\n", ["nothing is repeated"]),
        (HEAD + "  - {repeat: " + TASK + ", times: 0}\n", ["whole number from 1 to", "would repeat for ever"]),
        (HEAD + "  - {repeat: {wait: 0.01}, times: 2}\n", ["would turn without a pause; put a task or `wait: 0.05`"]),
        (
            HEAD + "  - {repeat: {repeat: " + TASK + ", times: 2000}, times: 2000}\n",
            ["would repeat 4000000 times in all; at most 1000000 are done"],
        ),
        (HEAD + "  - {wait: 1e9}\n", ["a number of seconds above 0, at most 1e+08"]),
        (HEAD + "  - wait:\n", ["F:4:steps[0]: waits for no one thing"]),
        (HEAD + "  - {wait: 2, event: E}\n", ["waits for no one thing"]),
        (HEAD + "  - {wait: soon}\n", ["`wait` must be a number of seconds above 0"]),
        (HEAD + "  - {end: maybe}\n", ["`end` is one of `done`, `failed`"]),
        ("version: 1\nname: s\nparameters: [a]\nsteps: " + TASK, ["F:3:parameters: parameters are names"]),
        ("version: 1\nname: s\nparameters: {a: {range: [2, 1]}}\nsteps: " + TASK, ["a range is two numbers"]),
        (
            "version: 1\nname: s\nparameters: {a: {default: 9, range: [1, 2]}}\nsteps: " + TASK,
            ["9 is outside of 1 to 2"],
        ),
        ("version: 1\nname: s\nparameters: {a: {default: [1]}}\nsteps: " + TASK, ["a default is a number"]),
        (
            "version: 1\nname: s\nsteps:\n" + "  - {end: done}\n" * 10_002,
            ["F:10004:steps[10000]: a scenario has at most"],
        ),
        ("a: [", ["is not YAML"]),
        ("\t- x", ["is not YAML"]),
        ("x: &a 1\ny: *a", ["anchors"]),
    ],
)
def test_each_mistake_is_said_with_its_line(text: str, said: list[str]) -> None:
    problems = [str(problem) for problem in read_scenario(text.encode(), "F").problems]
    assert len(problems) == len(said), problems
    for problem, expected in zip(problems, said, strict=True):
        assert expected in problem
        assert "\n" not in problem


def test_all_mistakes_are_said_at_once_in_the_order_of_their_lines() -> None:
    text = HEAD + "  - {task: a}\n  - {end: maybe}\n  - {wait: , x: 1}\n"
    with pytest.raises(ScenarioInvalid) as caught:
        scenario_of(text, "F")
    lines = [int(problem.split(":")[1]) for problem in caught.value.problems]
    assert lines == [4, 4, 5, 6, 6]


def test_deep_nesting_ends_in_a_problem() -> None:
    text = HEAD + "  - " + "{sequence: [" * 60 + TASK + "]}" * 60
    (problem, *_) = read_scenario(text.encode(), "F").problems
    assert "nested deeper" in str(problem)


KEYS = (
    *("task", "robot", "skill", "arguments", "parallel", "sequence", "if", "then", "else", "repeat", "times"),
    *("while", "wait", "until", "event", "end", "after", "capacity", "retries", "x"),
)

json_values: Any = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(-5, 5), st.floats(), st.text(max_size=5)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(
            st.sampled_from(KEYS),
            inner,
            max_size=4,
        ),
    ),
    max_leaves=12,
)


@given(json_values, json_values)
def test_whatever_stands_there_is_a_scenario_or_problems(steps: Any, parameters: Any) -> None:
    data = {"version": 1, "name": "s", "steps": steps, "parameters": parameters}
    reading = read_scenario(json.dumps(data).encode(), "F")
    for problem in reading.problems:
        assert "\n" not in str(problem)
