"""fleet.yaml as nodes."""

from __future__ import annotations

from typing import Any

import pytest

from tests.unit.fleet.fleet_of import BRIDGE, fleet_config, key
from ua_fleet.config.nodes import fleet_model, mapped_sources, max_ages_of
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ConfigError
from ua_fleet.fleet import FleetModel
from ua_fleet.topics import Topic
from ua_fleet.values import ARRAY, BuiltinType


def model(**data: Any) -> FleetModel:
    return fleet_model(fleet_config({"rover": {"bridge": "mobile", "data": data}}))


def test_one_field_is_the_variable_and_several_have_names_below_it() -> None:
    single, several = (
        model(speed={"id": 5, "type": "Float", "array": True}, pose={"id": 6, "fields": {"x": {"type": "Double"}}})
        .robots[0]
        .data_sets
    )
    assert (single.key, single.is_single, single.fields[0].key) == (key(5), True, key(5))
    assert single.fields[0].type == BuiltinType.FLOAT | ARRAY
    assert (several.key, several.is_single, several.fields[0].key) == (key(6), False, key("6.x"))


def test_the_origin_is_in_the_topic() -> None:
    robot, server = (
        model(speed={"id": 5, "type": "Float"}, goal={"id": 6, "type": "Float", "origin": "server"}).robots[0].data_sets
    )
    assert (robot.topic, robot.writable) == (Topic(2, 2, 5), False)
    assert (server.topic, server.writable) == (Topic(0, 2, 6), True)


def test_a_bridge_is_its_status_data_set() -> None:
    bridge = model().bridges[0]
    assert bridge.status is not None
    assert (bridge.key, bridge.status.topic) == (key(1900), BRIDGE)
    names = [field.name for field in bridge.status.fields]
    assert {"Connected", "Detail", "MessagesIn", "Looped", "Drops.loop"} <= set(names)


def test_a_data_source_without_an_id_has_no_node() -> None:
    with pytest.raises(ConfigError, match=r"robots\.rover\.data\.a\.id: the data source has no id"):
        model(a={"type": "Float"})


@pytest.mark.parametrize(
    ("field", "initial"),
    [
        ({"type": "Double", "initial": 1}, 1.0),
        ({"type": "Int32", "initial": -7}, -7),
        ({"type": "Boolean", "initial": False}, False),
        ({"type": "String", "initial": "x"}, "x"),
        ({"type": "Double", "range": [0, 1], "initial": 1}, 1.0),
    ],
)
def test_initial_values_get_the_fields_type(field: dict[str, Any], initial: Any) -> None:
    made = model(a={"id": 5, "origin": "server", **field}).robots[0].data_sets[0].fields[0]
    assert made.initial == initial
    assert type(made.initial) is type(initial)


def test_robots_data_has_no_initial_value() -> None:
    assert model(a={"id": 5, "type": "Int32", "initial": 3}).robots[0].data_sets[0].fields[0].initial is None


def test_maximum_ages_and_sources_go_to_the_namespace_of_their_robot() -> None:
    config = FleetConfig.model_validate(
        {
            "version": 1,
            "fleet": {"namespaces": ["urn:more"]},
            "pubsub": {"security": "none"},
            "bridges": {"cell": {"kind": "ros2", "space": 7}},
            "robots": {
                "press": {
                    "bridge": "cell",
                    "namespace": 4,
                    "data": {
                        "level": {"id": 9, "type": "Double", "max_age_s": 2.5},
                        "other": {"id": 10, "type": "Int32"},
                    },
                }
            },
            "sources": {"a": {"publisher_id": 5, "data_set_writer_id": 1, "robot": "press", "data": "level"}},
        }
    )
    assert max_ages_of(config) == {Topic(7, 4, 9): 2.5}
    assert mapped_sources(config).topics == {Topic(7, 4, 9)}
    [level, other] = fleet_model(config).robots[0].data_sets
    assert (level.max_age_s, other.max_age_s) == (2.5, None)
