"""Skills and resilience in `fleet.yaml`."""

from __future__ import annotations

import pytest

from ua_fleet.config.assign_ids import insert_ids
from ua_fleet.config.load import load_content
from ua_fleet.config.nodes import fleet_model
from ua_fleet.errors import ConfigInvalid
from ua_fleet.orchestrator import DistanceFrom, TasksAhead, ValueOf
from ua_fleet.resilience import DecisionMode, OnLimit, Synthesis
from ua_fleet.values import BuiltinType, NodeId

HEAD = """\
version: 1
pubsub: {security: none}
bridges:
  floor: {kind: ros2, space: 2, status_id: 1}
"""
ROBOT = (
    HEAD
    + """\
robots:
  ur3:
    bridge: floor
    capacities: [grab]
    skill_status_id: 3
    skills:
      turn:
"""
)
TURN = """\
        id: 2
        needs: [grab]
        arguments:
          angle: {type: Double, unit: deg, range: [-90, 90]}
          speed: {type: Double, unit: deg/s, default: 10}
        results: {reached: {type: Double, unit: deg}}
        timeout_s: 20
        immediate: true
        limits: {least_interval_s: 0.5, visible_to: [0, 1]}
"""


def problems(text: str, *, allow_missing_ids: bool = False) -> list[str]:
    with pytest.raises(ConfigInvalid) as caught:
        load_content(text.encode(), "f.yaml", {}, allow_missing_ids=allow_missing_ids)
    return [str(problem) for problem in caught.value.problems]


def test_a_skill_is_in_the_model() -> None:
    model = fleet_model(load_content((ROBOT + TURN).encode(), "f.yaml", {}))
    (robot,) = model.robots
    assert robot.skill_status is not None
    assert (robot.skill_status.space, robot.skill_status.id) == (2, 3)
    (skill,) = robot.skills
    assert (skill.id, skill.name, skill.capacities) == (2, "turn", ("grab",))
    assert (skill.timeout_s, skill.immediate) == (20, True)
    angle, speed = skill.arguments
    assert (angle.type, angle.unit, angle.range, angle.default) == (BuiltinType.DOUBLE, "deg", (-90, 90), None)
    assert speed.default == 10
    assert [result.name for result in skill.results] == ["reached"]
    assert (skill.limits.least_interval_s, skill.limits.visible_to) == (0.5, (0, 1))
    assert skill.filled({"angle": 5.0}) == {"angle": 5.0, "speed": 10}


def test_missing_ids_are_asked_for_and_assigned() -> None:
    text = (ROBOT + TURN).replace("        id: 2\n", "").replace("    skill_status_id: 3\n", "")
    said = problems(text)
    assert len(said) == 2
    assert "robots.ur3.skill_status_id: `skill_status_id` is missing; run: ua-fleet config assign-ids" in said[0]
    assert "robots.ur3.skills.turn.id: `id` is missing" in said[1]
    changed, given = insert_ids(text.encode(), "f.yaml")
    assert given == {"robots.ur3.skill_status_id": 1001, "robots.ur3.skills.turn.id": 1002}
    robot = load_content(changed, "f.yaml", {}).robots["ur3"]
    assert (robot.skill_status_id, robot.skills["turn"].id) == (1001, 1002)


@pytest.mark.parametrize(
    ("skill", "said"),
    [
        (
            "        id: 1\n",
            "f.yaml:12:robots.ur3.skills.turn.id: 1 is in use already (bridges.floor.status_id, line 4)",
        ),
        ("        id: 3\n", "3 is in use already"),
        ("        id: 2\n        needs: [fly]\n", "needs[0]: ur3 lacks the capacity `fly`; add it to robots.ur3"),
        ("        id: 2\n        needs: [grib]\n", "did you mean `grab`?"),
        ("        id: 2\n        via: {topic: /x}\n", "via.topic: must be keys with values"),
        ("        id: 2\n        timeout_s: 0\n", "timeout_s"),
        ("        id: 2\n        argument: {}\n", "unknown key `argument`; did you mean `arguments`?"),
        ("        id: 2\n        arguments: {a: {type: DateTime}}\n", "an argument is no DateTime"),
        ("        id: 2\n        arguments: {a: {type: Double, range: [2, 1]}}\n", "the first value must be less"),
        ("        id: 2\n        arguments: {a: {type: String, range: [1, 2]}}\n", "String has no range"),
        ("        id: 2\n        arguments: {a: {type: Byte, default: 256}}\n", "BYTE goes from 0 to 255"),
        ("        id: 2\n        arguments: {a: {type: Double, range: [0, 1], default: 2}}\n", "legal is 0 to 1"),
        ("        id: 2\n        arguments: {a b: {type: Double}}\n", "a b"),
        ("        id: 2\n        limits: {requests_at_once: 0}\n", "requests_at_once"),
    ],
)
def test_mistakes_in_a_skill(skill: str, said: str) -> None:
    (problem,) = problems(ROBOT + skill)
    assert said in problem
    assert "\n" not in problem


RESILIENCE = (
    HEAD
    + """\
resilience:
  mode: automatic
  limit_s: 5
  on_limit: abort
  synthesis: ideal
  criteria:
    battery: {kind: benefit, range: [0, 100], unit: "%", value: battery.percentage}
    distance:
      {kind: cost, range: [0, 50], distance: {x: pose.x, y: pose.y, argument: to, places: {dock: [1, 2]}}}
    free: {kind: benefit, range: [0, 100], tasks_ahead: true}
  judgements:
    battery: {distance: 2, free: 3}
    free: {distance: 0.7}
"""
)


def test_resilience() -> None:
    settings = load_content(RESILIENCE.encode(), "f.yaml", {}).resilience.settings()
    assert [source for _, source in settings.criteria] == [
        ValueOf("battery.percentage"),
        DistanceFrom("pose.x", "pose.y", "to", {"dock": (1, 2)}),
        TasksAhead(),
    ]
    assert settings.judgements["battery", "free"] == 3
    assert (settings.mode, settings.on_limit, settings.synthesis) == (
        DecisionMode.AUTOMATIC,
        OnLimit.ABORT,
        Synthesis.IDEAL,
    )


def test_without_a_word_the_least_busy_robot_is_offered_to_the_operator() -> None:
    settings = load_content(HEAD.encode(), "f.yaml", {}).resilience.settings()
    assert settings.mode is DecisionMode.OPERATOR
    assert [source for _, source in settings.criteria] == [TasksAhead()]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("free: 3}", "}", "'battery' and 'free' are not compared"),
        ("distance: 2,", "distance: 12,", "is 12; Saaty's scale goes from 1/9 to 9"),
        ("distance: 0.7", "distance: 9", "the judgements contradict each other"),
        ("distance: 0.7", "distance: 0", "greater than 0"),
        ("distance: 0.7", "distnce: 0.7", "'distnce' is not among"),
        ("tasks_ahead: true", "tasks_ahead: false", "exactly one of `value`, `distance` and `tasks_ahead"),
        ("tasks_ahead: true", "tasks_ahead: true, value: x", "exactly one of"),
        ("range: [0, 50]", "range: [50, 0]", "the first value must be less"),
        ("mode: automatic", "mode: auto", "automatic"),
    ],
)
def test_mistakes_in_resilience(old: str, new: str, said: str) -> None:
    assert old in RESILIENCE
    said_all = problems(RESILIENCE.replace(old, new))
    assert any(said in problem for problem in said_all), said_all
    assert all(problem.startswith("f.yaml:") and "\n" not in problem for problem in said_all)


def test_the_id_of_announced_faults_is_one_of_the_fleet() -> None:
    text = (ROBOT + TURN).replace("    skills:\n", "    fault_id: 1007\n    skills:\n")
    (robot,) = fleet_model(load_content(text.encode(), "f.yaml", {})).robots
    assert robot.fault is not None
    assert (robot.fault.topic.name, robot.fault.key) == ("ua_2_2_1007", NodeId(2, 1007))
    (said,) = problems(text.replace("fault_id: 1007", "fault_id: 3"))
    assert "robots.ur3.fault_id: 3 is in use already (robots.ur3.skill_status_id, line" in said
    assert said.endswith("choose another number")
    _, given = insert_ids(text.replace("        id: 2\n", "").encode(), "f.yaml")
    assert given == {"robots.ur3.skills.turn.id": 1008}
