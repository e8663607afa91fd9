"""Clients' writes become publications of space 0."""

from __future__ import annotations

import math
from typing import Any

import pytest
from ua_bridges.ros.topic_mapping import TopicMapping

from tests.unit.fleet.fleet_of import BOOLEAN, DOUBLE, STATUS, STRING, fleet_config, key
from ua_fleet.config.nodes import fleet_model
from ua_fleet.fleet import Commands, Publication
from ua_fleet.pubsub.metadata import first_property
from ua_fleet.topics import Topic
from ua_fleet.values import ARRAY, BuiltinType, StatusCode
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData

VELOCITY = Topic(0, 2, 10)
GOAL = Topic(0, 2, 11)
WAITING = int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)


def commands(**more: Any) -> Commands:
    data = {
        "velocity": {
            "id": 10,
            "origin": "server",
            "fields": {"linear.x": {"type": "Double", "range": [-1, 1]}, "angular.z": {"type": "Double"}},
            "sink": TopicMapping(topic="/cmd_vel", type="geometry_msgs/msg/Twist"),
        },
        "goal": {"id": 11, "origin": "server", "type": "Boolean"},
        "text": {"id": 12, "origin": "server", "type": "String"},
        "path": {"id": 13, "origin": "server", "type": "Double", "array": True},
        "speed": {"id": 14, "type": "Double"},
    } | more
    return Commands(fleet_model(fleet_config({"rover": {"bridge": "mobile", "data": data}})))


def test_a_write_publishes_the_whole_data_set_with_what_is_unknown_as_bad() -> None:
    state = commands()
    assert state.write(key("10.linear.x"), DOUBLE, 0.5, None, 100) == (100, None)
    assert state.flush() == [Publication(VELOCITY, (DOUBLE, STATUS), (0.5, WAITING), 100)]
    assert state.flush() == []
    state.write(key("10.angular.z"), DOUBLE, 2.0, None, 101)
    assert state.flush() == [Publication(VELOCITY, (DOUBLE, DOUBLE), (0.5, 2.0), 101)]


def test_writes_of_one_request_make_one_publication() -> None:
    state = commands()
    state.write(key("10.linear.x"), DOUBLE, 0.5, None, 100)
    state.write(key("10.angular.z"), DOUBLE, 0.1, None, 100)
    assert [publication.values for publication in state.flush()] == [(0.5, 0.1)]


def test_a_second_write_of_a_field_loses_nothing() -> None:
    state = commands()
    assert state.write(key(11), BOOLEAN, True, None, 100) == (100, None)
    timestamp, before = state.write(key(11), BOOLEAN, False, None, 100)
    assert before == Publication(GOAL, (BOOLEAN,), (True,), 100)
    assert timestamp == 101
    assert state.flush() == [Publication(GOAL, (BOOLEAN,), (False,), 101)]


@pytest.mark.parametrize(
    ("given", "taken"),
    [(None, 200), (150, 150), (200, 200), (201, 200), (100, 200), (5, 200)],
    ids=["none", "between", "now", "future", "the last one", "long ago"],
)
def test_times_strictly_increase(given: int | None, taken: int) -> None:
    state = commands()
    state.write(key(11), BOOLEAN, True, None, 100)
    state.flush()
    assert state.write(key(11), BOOLEAN, True, given, 200)[0] == taken


def test_times_increase_when_the_clock_goes_back() -> None:
    state = commands()
    stamps: list[int] = []
    for wall in (100, 50, 50):
        stamps.append(state.write(key(11), BOOLEAN, True, None, wall)[0])
        state.flush()
    assert stamps == [100, 101, 102]


@pytest.mark.parametrize(
    ("identifier", "type_code", "value", "status"),
    [
        ("10.linear.x", DOUBLE, 1.0, StatusCode.GOOD),
        ("10.linear.x", DOUBLE, 1.01, StatusCode.BAD_OUT_OF_RANGE),
        ("10.linear.x", DOUBLE, math.nan, StatusCode.BAD_OUT_OF_RANGE),
        ("10.linear.x", DOUBLE, -math.inf, StatusCode.BAD_OUT_OF_RANGE),
        ("10.angular.z", DOUBLE, math.nan, StatusCode.GOOD),
        ("10.angular.z", BuiltinType.FLOAT, 1.0, StatusCode.BAD_TYPE_MISMATCH),
        ("10.angular.z", DOUBLE | ARRAY, (1.0,), StatusCode.BAD_TYPE_MISMATCH),
        (11, 0, None, StatusCode.BAD_TYPE_MISMATCH),
        (11, BuiltinType.INT32, 1, StatusCode.BAD_TYPE_MISMATCH),
        (12, STRING, "x" * 1000, StatusCode.GOOD),
        (12, STRING, "é" * 40_000, StatusCode.BAD_OUT_OF_RANGE),
        (13, DOUBLE | ARRAY, (1.0,) * 1000, StatusCode.GOOD),
        (13, DOUBLE | ARRAY, (1.0,) * 7000, StatusCode.BAD_OUT_OF_RANGE),
        (13, DOUBLE | ARRAY, None, StatusCode.BAD_TYPE_MISMATCH),
        (14, DOUBLE, 1.0, StatusCode.BAD_NOT_WRITABLE),
        ("Robots.rover.State", BuiltinType.INT32, 1, StatusCode.BAD_NOT_WRITABLE),
    ],
)
def test_what_a_client_may_write(identifier: int | str, type_code: int, value: Any, status: StatusCode) -> None:
    assert commands().check(key(identifier), int(type_code), value) == status


def test_initial_values_are_published_from_the_start() -> None:
    state = commands(mode={"id": 15, "origin": "server", "type": "Int32", "initial": 3})
    assert state.initial(100) == [Publication(Topic(0, 2, 15), (int(BuiltinType.INT32),), (3,), 100)]
    assert state.write(key(15), int(BuiltinType.INT32), 4, None, 100)[0] == 101


def test_only_what_originates_in_the_server_is_announced_with_its_message_type() -> None:
    announced = {model.topic: fields for model, fields in commands().sources()}
    assert sorted(topic.id for topic in announced) == [10, 11, 12, 13]
    fields = announced[VELOCITY]
    assert [field.name for field in fields] == ["linear.x", "angular.z"]
    metadata = DataSetMetaData("velocity", fields, ConfigurationVersion(1, 1))
    assert first_property(metadata, "RosType") == "geometry_msgs/Twist"
    assert announced[Topic(0, 2, 13)][0].value_rank == 1


def test_fields_with_other_paths_announce_no_message_type() -> None:
    fields = {"forward": {"type": "Double", "path": "linear.x"}, "turn": {"type": "Double", "path": "angular.z"}}
    sink = TopicMapping(topic="/cmd_vel", type="geometry_msgs/Twist")
    state = commands(drive={"id": 20, "origin": "server", "fields": fields, "sink": sink})
    announced = {model.topic.id: fields for model, fields in state.sources()}
    assert all(not field.properties for field in announced[20])
