"""Values of robots by their names."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import FleetConfig
from ua_fleet.operation.runs.values import FleetValues, fleet_view
from ua_fleet.scenario import ValueUnknown, read_scenario, validate
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
            "rover": {
                "bridge": "cell",
                "data": {
                    "battery": {"id": 1004, "type": "Double"},
                    "joints": {"id": 1005, "type": "Double", "array": True},
                },
            },
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
        "rover.joints": 1,
        "joints": 1,
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


def test_what_is_not_a_number_is_not_known(values: FleetValues) -> None:
    """`battery < 20` would be false and end a fault, and `not battery < 20` would be true."""
    values.take(NodeId(2, 1001), math.nan, 0)
    with pytest.raises(ValueUnknown, match="its robot says NaN"):
        values.look_up("ur3.battery")
    values.take(NodeId(2, 1001), math.inf, 0)
    assert values.look_up("ur3.battery") == math.inf


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


def test_elements_of_arrays_have_an_index(values: FleetValues) -> None:
    values.take(NodeId(2, 1005), (0.25, 0.5), 0)
    assert (values.look_up("joints[1]"), values.look_up("rover.joints[0]")) == (0.5, 0.25)
    for name, said in (
        ("joints[2]", "joints has 2 elements now"),
        ("joints", "no number, text or truth value"),
        ("goal[0]", "goal is no array"),
    ):
        with pytest.raises(ValueUnknown, match=said):
            values.look_up(name)
    values.take(NodeId(2, 1005), (0.25, 0.5), int(StatusCode.BAD_NO_COMMUNICATION))
    with pytest.raises(ValueUnknown, match="BadNoCommunication"):
        values.look_up("joints[1]")


@pytest.mark.parametrize(
    ("condition", "said"),
    [
        ("rover.joints[1] > 0.5 and joints[0] < 1", []),
        ("joints > 0.5", ["'joints' is an array; write joints[0]"]),
        ("ur3.battery[0] > 1", ["'ur3.battery' is no array"]),
        ("speed[0] > 1", ["'speed' is no array"]),
    ],
)
def test_conditions_name_elements_of_arrays_alone(condition: str, said: list[str]) -> None:
    model = fleet_model(CONFIG)
    head = "version: 1\nname: a\nparameters: {speed: {default: 1}}\nsteps:\n"
    text = f"{head}  - {{wait: null, until: {condition!r}}}\n"
    scenario = read_scenario(text.encode(), "").scenario
    problems = validate(scenario, fleet_view(model.robots, FleetValues(model).meanings)).problems
    assert [str(problem).partition(":")[2].strip() for problem in problems] == said


def test_robots_come_and_go(values: FleetValues) -> None:
    rover, before = fleet_model(CONFIG).robots[1], dict(values.meanings)
    values.remove(rover)
    assert values.meanings["battery"] == 1
    assert "rover.battery" not in values.meanings
    values.take(NodeId(2, 1001), 80.0, 0)
    assert values.look_up("battery") == 80.0
    assert not values.take(NodeId(2, 1004), 10.0, 0)
    values.add(rover)
    assert dict(values.meanings) == before
    values.take(NodeId(2, 1004), 10.0, 0)
    assert values.look_up("rover.battery") == 10.0
    with pytest.raises(ValueUnknown):
        values.look_up("battery")


def test_a_value_that_nothing_says_is_of_now_is_not_known(values: FleetValues) -> None:
    values.take(NodeId(2, 1001), 3.0, int(StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE))
    with pytest.raises(ValueUnknown, match="too old"):
        values.look_up("ur3.battery")
    values.take(NodeId(2, 1001), 3.0, 0)
    assert values.look_up("ur3.battery") == 3.0


def test_the_last_value_of_what_rests_is_not_known() -> None:
    model = fleet_model(CONFIG)
    resting = replace(model, bridges=tuple([replace(bridge, reads_on_demand=True) for bridge in model.bridges]))
    for there, is_known in ((FleetValues(model), True), (FleetValues(resting), False)):
        there.take(NodeId(2, 1001), 3.0, int(StatusCode.UNCERTAIN_LAST_USABLE_VALUE))
        if is_known:
            assert there.look_up("ur3.battery") == 3.0
        else:
            with pytest.raises(ValueUnknown, match="was not read since"):
                there.look_up("ur3.battery")
        there.take(NodeId(2, 1001), 4.0, 0)
        assert there.look_up("ur3.battery") == 4.0


def test_the_nodes_that_a_scenario_asks_for(values: FleetValues) -> None:
    head = "version: 1\nname: a\nsteps:\n"
    steps = ["{wait: null, until: 'joints[0] > 1 and ur3.battery > 20'}", "{if: 'pose.x > 2', then: [{wait: 1 s}]}"]
    text = head + "".join([f"  - {step}\n" for step in steps])
    scenario = read_scenario(text.encode(), "").scenario
    names = set(scenario.names())
    assert names == {"joints[0]", "ur3.battery", "pose.x"}
    assert values.keys_of(names) == {NodeId(2, 1005), NodeId(2, 1001), NodeId(2, "1002.x")}
    assert values.keys_of([]) == set()
