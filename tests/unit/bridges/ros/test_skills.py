"""`via` of skills in `fleet.yaml`."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError
from ua_bridges.ros.skills import ActionSkill, RosSkillMapping, TopicSkill, skill_specs

from ua_fleet.config.load import load_content
from ua_fleet.errors import ConfigInvalid
from ua_fleet.topics import Topic

FLEET = """\
version: 1
pubsub: {security: none}
bridges:
  floor: {kind: ros2, space: 2, status_id: 1}
robots:
  carrier:
    bridge: floor
    skill_status_id: 3
    skills:
      drive:
        id: 2
        arguments: {speed: {type: Double}}
        limits: {requests_at_once: 3}
        via: {topic: {topic: cmd_vel, type: geometry_msgs/Twist, fields: {speed: linear.x}}}
      dock:
        id: 4
        arguments: {gate: {type: Int32}}
        results: {took: {type: Double}}
        immediate: true
        limits: {requests_at_once: 3}
      later: {}
"""


def test_skills_of_a_bridge() -> None:
    drive, dock = skill_specs(load_content(FLEET.encode(), "f.yaml", {}, allow_missing_ids=True), "floor")
    assert drive.via is not None
    assert isinstance(drive.via.way, TopicSkill)
    offer = drive.offer()
    assert (offer.topic, offer.name, offer.limits.requests_at_once) == (Topic(2, 2, 2), "drive", 1), (
        "a topic knows one at a time"
    )
    assert [(target.id, target.name, target.status) for target in offer.targets] == [(1, "carrier", Topic(2, 2, 3))]
    assert dock.via is None
    assert (dock.request_topic, dock.status_topic) == ("ua_0_2_4", "ua_2_2_4")
    offer = dock.offer()
    assert ([field.name for field in offer.request], [field.name for field in offer.response]) == (["gate"], ["took"])
    assert (offer.is_immediate, offer.limits.requests_at_once) == (True, 3)


STATUS = {"topic": "/state", "type": "std_msgs/String", "done": "data == 'x'"}
TOPIC = {"topic": "/go", "type": "std_msgs/Empty"}


@pytest.mark.parametrize(
    "via",
    [
        {"topic": TOPIC},
        {"topic": {**TOPIC, "halt": {"a.b": 0.0}, "status": {**STATUS, "failed": "n > 1", "progress": "n / 100"}}},
        {"service": {"name": "/load", "type": "nav_msgs/srv/LoadMap", "constants": {"ids": [1, 2]}}},
        {"action": {"name": "turn", "type": "control_msgs/FollowJointTrajectory", "success": "error_code == 0"}},
    ],
)
def test_legal_mappings(via: dict[str, Any]) -> None:
    assert RosSkillMapping.model_validate(via).way


@pytest.mark.parametrize(
    ("via", "said"),
    [
        ({}, "give exactly one of topic, service, action; there is none"),
        ({"topic": TOPIC, "service": {"name": "/a", "type": "a_b/C"}}, "there is `topic`, `service`"),
        ({"topic": {**TOPIC, "status": {**STATUS, "done": "open(1)"}}}, "no call here"),
        ({"topic": {**TOPIC, "status": {**STATUS, "done": "data =="}}}, "is no condition"),
        ({"topic": {**TOPIC, "status": {"topic": "/s", "type": "std_msgs/String"}}}, "done"),
        ({"topic": {**TOPIC, "type": "Empty"}}, "String should match pattern"),
        ({"topic": {**TOPIC, "fields": {"a": "b..c"}}}, "String should match pattern"),
        ({"service": {"name": "/load", "type": "nav_msgs/action/LoadMap"}}, "String should match pattern"),
        ({"action": {"name": "no spaces", "type": "a_b/C"}}, "String should match pattern"),
        ({"action": {"name": "/a", "type": "a_b/C", "sucess": "true"}}, "sucess"),
    ],
)
def test_mistakes_in_a_mapping(via: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError) as caught:
        RosSkillMapping.model_validate(via)
    assert said in str(caught.value)


def said(text: str) -> list[str]:
    with pytest.raises(ConfigInvalid) as caught:
        load_content(text.encode(), "f.yaml", {}, allow_missing_ids=True)
    return [str(problem) for problem in caught.value.problems]


def test_names_that_the_skill_does_not_have() -> None:
    status = "{topic: /s, type: std_msgs/Int32, done: data == arguments.sped, results: {far: data}}"
    text = FLEET.replace("fields: {speed: linear.x}", f"fields: {{sped: linear.x}}, status: {status}")
    line = text[: text.index("sped: linear.x")].count("\n") + 1
    via = "robots.carrier.skills.drive.via.topic"
    assert said(text) == [
        f"f.yaml:{line}:{via}.fields.sped: drive has no argument `sped`; did you mean `speed`?",
        f"f.yaml:{line}:{via}.status.results.far: drive has no result `far`",
        f"f.yaml:{line}:{via}.status.done: drive has no argument `sped`; did you mean `speed`?",
    ]


def test_results_need_somewhere_to_come_from() -> None:
    text = FLEET.replace("        limits: {requests_at_once: 3}\n", "        results: {far: {type: Double}}\n", 1)
    (problem,) = said(text)
    assert "skills.drive.results: a topic without `status` brings no results; add `status`, or remove them" in problem


def test_the_one_that_is_given() -> None:
    mapping = RosSkillMapping.model_validate({"action": {"name": "/turn", "type": "a_b/C"}})
    assert isinstance(mapping.way, ActionSkill)
