"""A scenario held against a fleet: all problems at once, each with its line."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ua_fleet.fleet.skills import ArgumentModel, SkillModel
from ua_fleet.scenario.parameters import arguments_for
from ua_fleet.scenario.read import scenario_of
from ua_fleet.scenario.validate import FleetView, RobotView, Validation, validate
from ua_fleet.values import BuiltinType

TURN = SkillModel(
    1,
    "turn",
    ("grab",),
    (
        ArgumentModel("angle", BuiltinType.DOUBLE, "deg", (-90, 90)),
        ArgumentModel("speed", BuiltinType.DOUBLE, "deg/s", (0, 60), 10.0),
        ArgumentModel("label", BuiltinType.STRING, default="box"),
        ArgumentModel("count", BuiltinType.BYTE, default=1),
    ),
    (ArgumentModel("reached", BuiltinType.DOUBLE),),
)
GO = SkillModel(1, "go", ("mobile",), (ArgumentModel("to", BuiltinType.STRING),))
MEASURE = SkillModel(2, "measure", ("temperature",), (), (ArgumentModel("value", BuiltinType.DOUBLE),))
FLEET = FleetView(
    {
        "ur3": RobotView("ur3", frozenset({"grab", "temperature"}), {"turn": TURN, "measure": MEASURE}),
        "pioneer": RobotView("pioneer", frozenset({"mobile"}), {"go": GO}),
        "ridgeback": RobotView("ridgeback", frozenset({"mobile", "grab"}), {"go": GO, "turn": TURN}),
    },
    {"ur3.temperature": 1, "temperature": 1, "pioneer.battery": 1, "ridgeback.battery": 1, "battery": 2},
    frozenset({"BoxArrived"}),
)
HEAD = "version: 1\nname: s\nparameters: {limit: 3}\nsteps:\n"


def check(steps: str) -> Validation:
    return validate(scenario_of(HEAD + steps), FLEET, "F")


def test_what_fits_is_made_ready() -> None:
    checked = check(
        "  - task: a\n    robot: ur3\n    skill: turn\n"
        "    arguments: {angle: 0.5 rad, speed: =limit * 2, label: 20 deg, count: 3}\n"
        "  - if: a.reached > limit and battery2 > 1 or ur3.temperature > 20\n"
        "    then: {task: b, capacity: mobile, skill: go, arguments: {to: table_1}, after: [a]}\n"
        "  - {wait: , event: BoxArrived}\n".replace("battery2", "pioneer.battery")
    )
    assert checked.problems == ()
    a, b = checked.scenario.tasks()
    asked = arguments_for(a, FLEET.declared("ur3", "turn"), lambda _: 6.0)
    assert asked == {"angle": pytest.approx(28.6479), "speed": 12.0, "label": "20 deg", "count": 3}
    assert b.arguments == {"to": "table_1"}


def test_defaults_are_those_of_the_robot_that_is_asked() -> None:
    (task,) = check("  - {task: a, robot: ur3, skill: turn, arguments: {angle: 5}}\n").scenario.tasks()
    turn = FLEET.robots["ur3"].skills["turn"]
    filled = {"angle": 5, "speed": 10.0, "label": "box", "count": 1}
    assert arguments_for(task, turn, lambda _: 0.0) == filled
    other = replace(turn, arguments=(*turn.arguments, ArgumentModel("tool", BuiltinType.STRING, default="none")))
    assert arguments_for(task, other, lambda _: 0.0) == {**filled, "tool": "none"}


@pytest.mark.parametrize(
    ("steps", "said"),
    [
        ("  - {task: a, robot: ur4, skill: turn}\n", ["F:5: task 'a': there is no robot 'ur4'; did you mean `ur3`?"]),
        ("  - {task: a, robot: hal, skill: turn}\n", ["known robots: `ur3`, `pioneer`"]),
        ("  - {task: a, robot: ur3, skill: trun}\n", ["ur3 has no skill 'trun'; did you mean `turn`?"]),
        ("  - {task: a, robot: pioneer, skill: fly}\n", ["pioneer has no skill 'fly'; its skills: `go`"]),
        ("  - {task: a, capacity: fly, skill: go}\n", ["no robot with fly has the skill 'go'"]),
        ("  - {task: a, capacities: [mobile, temperature], skill: go}\n", ["no robot with mobile and temperature has"]),
        ("  - {task: a, robot: pioneer, skill: go}\n", ["the argument 'to' of go is missing"]),
        ("  - {task: a, robot: pioneer, skill: go, arguments: {to: x, by: y}}\n", ["go has no argument 'by'"]),
        ("  - {task: a, robot: pioneer, skill: go, arguments: {to: x, by: =limit}}\n", ["go has no argument 'by'"]),
        ("  - {task: a, robot: pioneer, skill: go, arguments: {to: 5}}\n", ["to is 5; it has to be a text"]),
        (
            "  - {task: a, robot: ur3, skill: turn, arguments: {angle: 91}}\n",
            ["angle is 91 deg; legal is -90 to 90 deg"],
        ),
        ("  - {task: a, robot: ur3, skill: turn, arguments: {angle: 2 rad}}\n", ["angle is 114.592 deg; legal"]),
        (
            "  - {task: a, robot: ur3, skill: turn, arguments: {angle: 2 m}}\n",
            ["m measures length, and deg"],
        ),
        ("  - {task: a, robot: ur3, skill: turn, arguments: {angle: 2 degs}}\n", ["unit 'degs' is not known; did you"]),
        ("  - {task: a, robot: ur3, skill: turn, arguments: {angle: x}}\n", ["angle is 'x'; it has to be a number"]),
        (
            "  - {task: a, robot: ur3, skill: turn, arguments: {angle: true}}\n",
            ["angle is True; it has to be a number"],
        ),
        ("  - {task: a, robot: ur3, skill: turn, arguments: {angle: 1, count: 300}}\n", ["BYTE goes from 0 to 255"]),
        ("  - {task: a, robot: ur3, skill: turn, arguments: {angle: 1, count: 1.5}}\n", ["has to be a whole number"]),
        ("  - {task: a, robot: ur3, skill: turn, arguments: {angle: 1, count: 2 s}}\n", ["count has no unit"]),
        ("  - {task: a, robot: ur3, skill: turn, arguments: {angle: =ur3.temprature}}\n", ["'ur3.temprature' is no"]),
        ("  - if: battery > 3\n    then: {end: done}\n", ["'battery' may be 2 values; write one of `pioneer.battery`"]),
        (
            "  - if: lmit > 3\n    then: {end: done}\n",
            ["'lmit' is no parameter, no result and no robot's value; did you"],
        ),
        (
            "  - {task: m, robot: ur3, skill: measure}\n  - if: m.valu > 3\n    then: {end: done}\n",
            ["F:6: measure has no result 'valu'; did you mean `value`?"],
        ),
        ("  - {wait: , event: BoxArived}\n", ["there is no event 'BoxArived'; did you mean `BoxArrived`?"]),
        ("  - {wait: , until: nothing.there}\n", ["'nothing.there' is no parameter"]),
        ("  - {repeat: {wait: 1}, while: nothing > 1}\n", ["'nothing' is no parameter"]),
        ("  - {end: done}\n  - {wait: 1}\n", ["F:6: is never reached: the run ends before"]),
        ("  - if: 1 > 2\n    then:\n      - {wait: 1}\n", ["F:7: is never reached: '1 > 2' is always false"]),
        ("  - if: true\n    else: {wait: 1}\n", ["is never reached: 'true' is always true"]),
        ("  - if: 1 > 'a'\n    then: {wait: 1}\n", ["'a' is no number"]),
        (
            "  - if: temperature > 2\n    then: {end: done}\n    else: [{wait: 1}, {end: failed}]\n  - {wait: 1}\n",
            ["F:8: is never reached: the run ends before"],
        ),
        ("  - sequence: [{end: done}]\n  - {wait: 1}\n", ["F:6: is never reached: the run ends before"]),
        (
            "  - parallel:\n      - [{wait: 3}, {end: done}]\n      - {wait: 1}\n  - {wait: 1}\n",
            ["F:8: is never reached: the run ends before"],
        ),
        (
            "  - repeat: [{wait: 1}, {end: done}]\n    times: 3\n  - {wait: 1}\n",
            ["F:7: is never reached: the run ends before"],
        ),
        ("  - {wait: , until: 1 > 2}\n  - {wait: 1}\n", ["F:5: never ends: '1 > 2' is always false"]),
        (
            "  - repeat:\n      - {wait: 1}\n    while: 1 > 2\n",
            ["F:6: is never reached: '1 > 2' is always false"],
        ),
        ("  - {repeat: {wait: 1}, while: 1 > 'a'}\n", ["F:5: 'a' is no number"]),
        ("  - {wait: , until: 1 > 'a'}\n", ["F:5: 'a' is no number"]),
        (
            "  - {task: a, robot: ur3, skill: measure, after: [bb]}\n",
            ["task 'a' comes after 'bb', which is not there"],
        ),
        (
            (
                "  - parallel:\n"
                "      - {task: a, robot: ur3, skill: measure, after: [b]}\n"
                "      - {task: b, robot: ur3, skill: measure, after: [a]}\n"
            ),
            ["F:7: tasks wait for each other: "],
        ),
        (
            "  - {task: a, robot: ur3, skill: measure, after: [b]}\n  - {task: b, robot: ur3, skill: measure}\n",
            ["F:6: tasks wait for each other: "],
        ),
        ("  - {task: a, robot: ur3, skill: measure, after: [a]}\n", ["F:5: tasks wait for each other: a after a"]),
        (
            (
                "  - parallel:\n"
                "      - {if: temperature > 1, then: {task: a, robot: ur3, skill: measure}}\n"
                "      - {task: b, robot: ur3, skill: measure, after: [a]}\n"
            ),
            ["F:7: task 'b' comes after 'a', which may never be done (line 6)"],
        ),
    ],
)
def test_each_problem_is_said_with_its_line(steps: str, said: list[str]) -> None:
    problems = [str(problem) for problem in check(steps).problems]
    assert len(problems) == len(said), problems
    for problem, expected in zip(problems, said, strict=True):
        assert expected in problem
        assert problem.startswith("F:")
        assert "\n" not in problem


def test_all_problems_are_said_at_once() -> None:
    checked = check(
        "  - {task: a, robot: ur4, skill: turn}\n"
        "  - {task: b, robot: ur3, skill: turn, arguments: {angle: 91, count: 300, x: 1}}\n"
        "  - {wait: , event: No}\n"
    )
    assert [problem.line for problem in checked.problems] == [5, 6, 6, 6, 7]


def test_what_may_be_reached_is_fine() -> None:
    checked = check(
        "  - if: temperature > 1\n    then: {end: done}\n"
        "  - {repeat: [{wait: 1}, {end: done}], while: temperature > 2}\n"
        "  - {wait: , until: 1 > 2, timeout_s: 3, on_timeout: continue}\n"
        "  - {repeat: {wait: 1}, while: 2 > 1, times: 2}\n"
        "  - {wait: 1}\n"
    )
    assert checked.problems == ()


def test_after_within_the_same_way_of_a_condition_is_fine() -> None:
    checked = check(
        "  - if: temperature > 1\n"
        "    then:\n"
        "      - parallel:\n"
        "          - {task: a, robot: ur3, skill: measure}\n"
        "          - {task: b, robot: ur3, skill: measure, after: [a]}\n"
    )
    assert checked.problems == ()
