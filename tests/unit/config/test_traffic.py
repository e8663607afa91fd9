"""Which messages the configuration gives a kind."""

from __future__ import annotations

from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.traffic import known_kinds
from ua_fleet.topics import Topic
from ua_fleet.traffic import MessageKind


def test_sensors_and_announced_faults_are_known() -> None:
    config = FleetConfig.model_validate(
        {
            "version": 1,
            "pubsub": {"security": "none"},
            "bridges": {"hall": {"kind": "ros2", "space": 7, "status_id": 900}},
            "robots": {
                "thermometer": {"bridge": "hall", "data": {"temperature": {"id": 1001, "type": "Double"}}},
                "rover": {
                    "bridge": "hall",
                    "fault_id": 1010,
                    "skill_status_id": 1011,
                    "skills": {"go": {"id": 1012}},
                    "data": {"battery": {"id": 1013, "type": "Double"}},
                },
                "lamp": {"bridge": "hall", "data": {"light": {"id": 1020, "type": "Boolean", "origin": "server"}}},
            },
        }
    )
    assert known_kinds(config) == {Topic(7, 2, 1001): MessageKind.SENSOR, Topic(7, 2, 1010): MessageKind.FAULT}
