"""What `history` in fleet.yaml says of each value."""

from __future__ import annotations

import json
from typing import Any

import pytest

from ua_fleet.config.history import HistoryRules
from ua_fleet.config.load import load_content
from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ConfigInvalid
from ua_fleet.history.rules import Rule
from ua_fleet.values import NodeId

SPEED, POSE_X, POSE_FRAME, NAME = NodeId(2, 1001), NodeId(2, "1002.x"), NodeId(2, "1002.frame"), NodeId(2, 1003)


def config_of(history: Any, robot: Any = None, speed: Any = None) -> FleetConfig:
    rover: dict[str, Any] = {
        "bridge": "floor",
        "data": {
            "speed": {"id": 1001, "type": "Double"},
            "pose": {"id": 1002, "fields": {"x": {"type": "Float"}, "frame": {"type": "String"}}},
            "name": {"id": 1003, "type": "Int32"},
        },
    }
    if robot is not None:
        rover["history"] = robot
    if speed is not None:
        rover["data"]["speed"]["history"] = speed
    raw = {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {"floor": {"kind": "ros2", "space": 2, "status_id": 1900}},
        "robots": {"rover": rover},
        **({} if history is None else {"history": history}),
    }
    return load_content(json.dumps(raw).encode(), "fleet.json", {})


def rules_of(*given: Any) -> HistoryRules:
    config = config_of(*given)
    rules = HistoryRules(config)
    for robot in fleet_model(config).robots:
        rules.add(robot)
    return rules


def test_without_the_key_nothing_is_kept() -> None:
    rules = rules_of(None)
    assert [rules.of(key) for key in (SPEED, POSE_X)] == [None, None]


def test_the_key_alone_keeps_each_change_of_all_robots_for_a_month() -> None:
    rules = rules_of({})
    assert rules.of(SPEED) == Rule(0, 0, 60, 30)
    assert [rules.is_stepped(key) for key in (SPEED, POSE_X, POSE_FRAME, NAME)] == [False, False, True, True]
    assert rules.of(NodeId(2, "Robots.rover.State")) is None
    assert rules.is_stepped(NodeId(2, 9)) is None


def test_each_level_says_what_differs_from_the_one_above() -> None:
    rules = rules_of({"deadband": 2, "at_most_each_s": 5}, {"days": 90, "at_most_each_s": 1}, {"deadband": 0.5})
    assert rules.of(SPEED) == Rule(deadband=0.5, at_most_each_s=1, at_least_each_s=60, days=90)
    assert rules.of(POSE_X) == Rule(deadband=2, at_most_each_s=1, at_least_each_s=60, days=90)
    assert rules.days_of(SPEED) == 90
    assert rules.days_of(NodeId(2, 9)) == 30


@pytest.mark.parametrize(
    ("top", "robot", "speed", "kept"),
    [
        ({}, None, None, (True, True)),
        ({}, False, None, (False, False)),
        ({}, False, True, (True, False)),
        ({}, None, False, (False, True)),
        ({"record": False}, None, None, (False, False)),
        ({"record": False}, True, None, (True, True)),
        ({"record": False}, None, {"days": 1}, (True, False)),
        ({"record": False}, {"days": 1}, False, (False, True)),
    ],
)
def test_whether_a_value_is_kept(top: Any, robot: Any, speed: Any, kept: tuple[bool, bool]) -> None:
    rules = rules_of(top, robot, speed)
    assert (rules.of(SPEED) is not None, rules.of(POSE_X) is not None) == kept


def test_a_robot_that_is_gone_is_forgotten() -> None:
    config = config_of({})
    rules = HistoryRules(config)
    [robot] = fleet_model(config).robots
    rules.add(robot)
    rules.remove(robot)
    assert rules.of(SPEED) is None


@pytest.mark.parametrize(
    ("given", "key"),
    [((None, {"days": 1}), "robots.rover.history"), ((None, None, True), "robots.rover.data.speed.history")],
)
def test_what_has_no_effect_is_a_problem(given: tuple[Any, ...], key: str) -> None:
    with pytest.raises(ConfigInvalid) as caught:
        config_of(*given)
    [problem] = caught.value.problems
    assert problem.key == key
    assert "`history` is missing at the top" in str(problem)


@pytest.mark.parametrize(
    "wrong",
    [{"days": 0}, {"megabytes": 1}, {"deadband": -1}, {"at_most_each_s": "x"}, {"day": 1}, {"days": float("inf")}],
)
def test_what_cannot_be_is_a_problem(wrong: dict[str, Any]) -> None:
    with pytest.raises(ConfigInvalid):
        config_of(wrong)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"store": "mysql://h/d"}, "another word than postgresql://"),
        ({"store": "postgresql://u:hidden@h/d"}, "has a user in it"),
        ({"store": "postgresql://h/d"}, "write `user` too"),
        ({"store": "postgresql://h"}, "no host or database"),
        ({"store": "postgresql://h:port/d"}, "is no address"),
        ({"store": "postgresql://h/d?options=-c"}, "unknown setting options"),
        ({"password_file": "secrets/history"}, "write `store` too"),
    ],
)
def test_what_a_database_is_not_named_by(given: dict[str, str], said: str) -> None:
    with pytest.raises(ConfigInvalid, match=said) as refused:
        config_of(given)
    assert "hidden" not in str(refused.value)


def test_a_database_in_place_of_the_file() -> None:
    url = "postgresql://db.plant:5433/history?sslmode=verify-full"
    history = config_of({"store": url, "user": "fleet", "password_file": "secrets/history"}).history
    assert history is not None
    assert (history.store, history.user, history.password_file) == (url, "fleet", "secrets/history")
