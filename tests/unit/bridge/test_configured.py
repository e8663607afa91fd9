"""What a bridge takes of the skills in `fleet.yaml`: their limits, and the ranges of their arguments."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tests.unit.bridge.test_actions import SPACE, Bench, Robot
from ua_fleet.bridge.configured import configured_faults, configured_sinks, configured_skills, configured_sources
from ua_fleet.config.base import Model, ScalarType
from ua_fleet.config.schema import DataMapping, FleetConfig
from ua_fleet.counters import Drop
from ua_fleet.fleet.skills import SkillLimits
from ua_fleet.pubsub.metadata import field_property
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode

CONFIG = FleetConfig.model_validate(
    {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {"cell": {"kind": "virtual", "space": SPACE}},
        "robots": {
            "arm": {
                "bridge": "cell",
                "skill_status_id": 1500,
                "skills": {
                    "pick": {
                        "id": 1501,
                        "arguments": {
                            "speed": {"type": "Double", "unit": "m/s", "range": [0.1, 0.5]},
                            "times": {"type": "Int32", "range": [1, 3]},
                        },
                        "results": {
                            "weight": {"type": "Double", "unit": "kg"},
                        },
                        "limits": {
                            "least_interval_s": 0.5,
                            "largest_message_bytes": 100,
                            "requests_at_once": 2,
                            "most_requestors": 3,
                            "visible_to": [0, 7],
                        },
                    }
                },
            }
        },
    }
)


DATA = FleetConfig.model_validate(
    {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {"cell": {"kind": "virtual", "space": SPACE}, "yard": {"kind": "virtual", "space": SPACE + 1}},
        "robots": {
            "arm": {
                "bridge": "cell",
                "fault_id": 9,
                "data": {
                    "pose": {"id": 1, "fields": {"x": {"type": "Double"}, "name": {"type": "String"}}, "source": {}},
                    "level": {"id": 2, "type": "Int32", "array": True},
                    "new": {"type": "Int32", "source": {}},
                    "speed": {"id": 3, "origin": "server", "type": "Float", "sink": {}},
                    "lamp": {"id": 4, "origin": "server", "type": "Boolean"},
                },
            },
            "cart": {
                "bridge": "yard",
                "data": {
                    "load": {"id": 5, "type": "Double", "source": {}},
                    "goal": {"id": 6, "origin": "server", "type": "Double", "sink": {}},
                },
            },
        },
    }
)


class Unmapped(Model, frozen=True):
    """No bridge's."""


def test_the_limits_are_those_of_fleet_yaml() -> None:
    (skill,) = configured_skills(CONFIG, "cell", Unmapped)
    assert skill.offer().limits == SkillLimits(0.5, 100, 2, 3, (0, 7))
    assert skill.offer() == skill.offer(), "else it would be announced again each second"


def test_a_requestor_is_told_what_values_mean() -> None:
    (skill,) = configured_skills(CONFIG, "cell", Unmapped)
    speed, times = skill.offer().request
    assert (field_property(speed, "Unit"), field_property(speed, "Range")) == ("m/s", (0.1, 0.5))
    assert field_property(speed, "Default") is None, "it has to be given"
    assert field_property(times, "Range") == (1.0, 3.0)
    (weight,) = skill.offer().response
    assert field_property(weight, "Unit") == "kg"


@pytest.mark.parametrize(
    ("type_name", "default"), [("Double", 0), ("UInt64", 2**64 - 1), ("String", "dock"), ("Boolean", False)]
)
def test_a_default_is_told_in_its_type(type_name: str, default: Any) -> None:
    document = CONFIG.model_dump(exclude_unset=True)
    document["robots"]["arm"]["skills"]["pick"]["arguments"] = {"it": {"type": type_name, "default": default}}
    (skill,) = configured_skills(FleetConfig.model_validate(document), "cell", Unmapped)
    offered = skill.offer()
    ((_, code, value),) = offered.request[0].properties
    assert (BuiltinType(code).name.lower(), value) == (type_name.lower(), default)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ((0.1, 3), None),
        ((0.5, 1), None),
        ((0.51, 1), "speed is 0.51 m/s; legal is 0.1 to 0.5 m/s"),
        ((math.nan, 1), "speed is nan; it has to be a number"),
        ((0.0, 4), "speed is 0 m/s; legal is 0.1 to 0.5 m/s; times is 4; legal is 1 to 3"),
    ],
)
def test_a_robot_hears_of_nothing_outside_a_range(values: tuple[Any, ...], said: str | None) -> None:
    robot = Robot()
    robot.offered = [skill.offer() for skill in configured_skills(CONFIG, "cell", Unmapped)]
    bench = Bench(robot=robot)
    bench.ask(values=values, types=(int(BuiltinType.DOUBLE), int(BuiltinType.INT32)))
    if said is None:
        assert [execution.values for execution in robot.begun] == [values]
        return
    assert robot.begun == []
    assert (bench.reports()[-1].status, bench.reports()[-1].message) == (StatusCode.BAD_OUT_OF_RANGE, said)
    assert bench.counters.drops == {Drop.REFUSED: 1}


def test_a_bridge_reads_what_its_robots_have() -> None:
    (pose,) = configured_sources(DATA, "cell", DataMapping)
    assert (pose.topic, pose.label) == (Topic(SPACE, 2, 1), "arm.pose")
    assert pose.types == {"x": ScalarType.DOUBLE, "name": ScalarType.STRING}
    _, level = configured_sources(DATA, "cell", DataMapping, DataMapping())
    assert level.types == {"value": ScalarType.INT32}
    assert [(field.name, field.value_rank) for field in level.fields] == [("level", 1)]


def test_a_bridge_writes_what_clients_write_and_what_it_mirrors() -> None:
    def topics(unmapped: DataMapping | None = None, **mirrors: DataMapping) -> list[Topic]:
        by_label = {name.replace("_", "."): sink for name, sink in mirrors.items()}
        return [data.topic for data in configured_sinks(DATA, "cell", DataMapping, unmapped, by_label)]

    speed, lamp = Topic(0, 2, 3), Topic(0, 2, 4)
    assert topics() == [speed]
    assert topics(DataMapping()) == [speed, lamp]
    mirrors = {"arm_pose": DataMapping(), "cart_load": DataMapping(), "cart_goal": DataMapping()}
    assert topics(**mirrors) == [speed, Topic(SPACE + 1, 2, 5), Topic(0, 2, 6)], "its own robot's are no others'"


def test_a_robot_without_an_id_for_it_says_no_faults() -> None:
    assert configured_faults(DATA, "cell") == {"arm": Topic(SPACE, 2, 9)}
    assert configured_faults(DATA, "yard") == {}
