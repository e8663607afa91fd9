"""Robots whose ids are of further namespaces."""

from __future__ import annotations

import pytest

from ua_fleet.config.assign_ids import insert_ids
from ua_fleet.config.load import load_content
from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ConfigInvalid
from ua_fleet.topics import Topic
from ua_fleet.values import NodeId

HEAD = """version: 1
pubsub: {security: none}
fleet: {namespaces: ["urn:hall-2", "urn:hall-3"]}
bridges:
  one: {kind: ros2, space: 2, status_id: 9001}
  two: {kind: ros2, space: 3, status_id: 9002}
robots:
"""


def fleet(text: str) -> FleetConfig:
    return load_content((HEAD + text).encode(), "f.yaml", {})


def problems(text: str) -> list[str]:
    with pytest.raises(ConfigInvalid) as caught:
        fleet(text)
    return [str(problem) for problem in caught.value.problems]


def test_an_id_is_one_in_its_namespace_and_the_robots_object_is_in_the_fleets() -> None:
    config = fleet(
        "  a: {bridge: one, data: {x: {id: 1001, type: Double}}}\n"
        "  b:\n    bridge: two\n    namespace: 4\n    skill_status_id: 1002\n    fault_id: 1003\n"
        "    data: {x: {id: 1001, type: Double}}\n    skills: {go: {id: 1004, timeout_s: 5}}\n"
    )
    model = fleet_model(config)
    assert model.namespaces == (2, 4, 5)
    a, b = model.robots
    assert (a.data_sets[0].topic, b.data_sets[0].topic) == (Topic(2, 2, 1001), Topic(3, 4, 1001))
    assert (b.key, b.part("State")) == (NodeId(2, "Robots.b"), NodeId(2, "Robots.b.State"))
    assert (b.skill_status, list(b.actions())) == (Topic(3, 4, 1002), [Topic(3, 4, 1004)])
    assert b.fault is not None
    assert b.fault.topic == Topic(3, 4, 1003)


def test_a_namespace_that_there_is_not_is_said_with_those_that_there_are() -> None:
    for number in (3, 6):
        (problem,) = problems(f"  a: {{bridge: one, namespace: {number}, data: {{x: {{id: 1001, type: Double}}}}}}\n")
        assert problem.startswith("f.yaml:8:robots.a.namespace: there is no such namespace; there are: 2, 4, 5; add")


def test_an_id_is_one_in_its_space_too_since_it_is_a_data_set_writer_id() -> None:
    (problem,) = problems(
        "  a: {bridge: one, data: {x: {id: 1001, type: Double}}}\n"
        "  b: {bridge: one, namespace: 4, data: {x: {id: 1001, type: Double}}}\n"
    )
    assert problem.startswith("f.yaml:9:robots.b.data.x.id: 1001 is in use already (robots.a.data.x.id, line 8)")
    (problem,) = problems(
        "  a: {bridge: one, data: {x: {id: 1001, type: Double, origin: server}}}\n"
        "  b: {bridge: two, namespace: 4, data: {x: {id: 1001, type: Double, origin: server}}}\n"
    )
    assert "robots.b.data.x.id: 1001 is in use already" in problem


def test_ids_are_assigned_by_namespace_and_bridge() -> None:
    text = HEAD + (
        "  a: {bridge: one, data: {x: {id: 65535, type: Double}}}\n"
        "  b:\n    bridge: two\n    namespace: 4\n    data:\n      x: {type: Double}\n      y: {type: Double}\n"
        "  c:\n    bridge: two\n    namespace: 5\n    data:\n      x: {type: Double}\n"
    )
    changed, given = insert_ids(text.encode().replace(b", status_id: 9002", b", status_id: 2000"), "f.yaml")
    assert given == {"robots.b.data.x.id": 2001, "robots.b.data.y.id": 2002, "robots.c.data.x.id": 2003}
    assert load_content(changed, "f.yaml", {}).robots["c"].namespace == 5


def test_five_thousand_robots_with_thirty_values_fit() -> None:
    bridges = {f"b{number}": {"kind": "ros2", "space": 2 + number, "status_id": 60001 + number} for number in range(5)}
    robots = {
        f"r{robot}": {
            "bridge": f"b{robot // 1000}",
            "namespace": (2, 4, 5, 6, 7)[robot // 1000],
            "data": {f"v{value}": {"id": 1 + robot % 1000 * 30 + value, "type": "Double"} for value in range(30)},
        }
        for robot in range(5000)
    }
    uris = [f"urn:hall-{number}" for number in range(4)]
    config = FleetConfig.model_validate(
        {
            "version": 1,
            "pubsub": {"security": "none"},
            "fleet": {"namespaces": uris},
            "bridges": bridges,
            "robots": robots,
        }
    )
    keys = {data_set.key for robot in fleet_model(config).robots for data_set in robot.data_sets}
    assert len(keys) == 150_000
