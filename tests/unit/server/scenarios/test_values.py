"""Values of robots by their names."""

from __future__ import annotations

import pytest

from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import FleetConfig
from ua_fleet.scenario import ValueUnknown
from ua_fleet.server.scenarios.values import FleetValues
from ua_fleet.values import NodeId, StatusCode

CONFIG = FleetConfig.model_validate(
    {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {"cell": {"kind": "virtual", "space": 2, "status_id": 900}},
        "robots": {
            "ur3": {
                "bridge": "cell",
                "data": {
                    "battery": {"id": 1001, "type": "Double"},
                    "pose": {"id": 1002, "fields": {"x": {"type": "Double"}, "frame": {"type": "String"}}},
                    "goal": {"id": 1003, "type": "Double", "origin": "server", "initial": 0.5},
                },
            },
            "rover": {"bridge": "cell", "data": {"battery": {"id": 1004, "type": "Double"}}},
        },
    }
)


@pytest.fixture
def values() -> FleetValues:
    return FleetValues(fleet_model(CONFIG))


def test_names_and_what_they_may_mean(values: FleetValues) -> None:
    assert values.meanings == {
        "ur3.battery": 1,
        "ur3.pose.x": 1,
        "ur3.pose.frame": 1,
        "ur3.goal": 1,
        "rover.battery": 1,
        "battery": 2,
        "pose.x": 1,
        "pose.frame": 1,
        "goal": 1,
    }


def test_values_are_found_by_both_names(values: FleetValues) -> None:
    assert values.take(NodeId(2, "1002.x"), 1.5, 0)
    assert (values.look_up("ur3.pose.x"), values.look_up("pose.x")) == (1.5, 1.5)
    assert values.look_up("goal") == 0.5
    assert not values.take(NodeId(2, "Robots.ur3.State"), 1, 0)


@pytest.mark.parametrize("name", ["battery", "nothing", "ur3.nothing"])
def test_names_that_mean_nothing_or_too_much_have_no_value(values: FleetValues, name: str) -> None:
    with pytest.raises(ValueUnknown, match="there is no value"):
        values.look_up(name)


def test_a_bad_value_is_not_known(values: FleetValues) -> None:
    with pytest.raises(ValueUnknown, match="BadWaitingForInitialData"):
        values.look_up("ur3.battery")
    values.take(NodeId(2, 1001), 20.0, 0)
    values.take(NodeId(2, 1001), 20.0, int(StatusCode.BAD_NO_COMMUNICATION))
    with pytest.raises(ValueUnknown, match="not known now"):
        values.look_up("ur3.battery")
    values.take(NodeId(2, 1001), (1.0, 2.0), 0)
    with pytest.raises(ValueUnknown, match="no number, text or truth value"):
        values.look_up("ur3.battery")
