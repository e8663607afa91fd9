"""A robot with skills, and what its SkillStatus says."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tests.unit.fleet.fleet_of import fleet_config, metadata_of
from ua_fleet.config.nodes import fleet_model
from ua_fleet.fleet import FleetModel
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.skill.status import SKILL_STATUS_FIELDS, ExecutionStatus, SkillStatus
from ua_fleet.topics import Topic
from ua_fleet.values import NodeId
from ua_fleet.wire.messages import DataSetMessage

STATUS = Topic(2, 2, 1502)
TURN, BLINK = NodeId(2, 1500), NodeId(2, 1501)

ROBOTS: Mapping[str, Any] = {
    "arm": {
        "bridge": "mobile",
        "capacities": ["grab"],
        "skill_status_id": STATUS.id,
        "skills": {
            "turn": {
                "id": 1500,
                "description": "Turns the arm.",
                "needs": ["grab"],
                "arguments": {
                    "angle": {
                        "type": "Double",
                        "unit": "deg",
                        "range": [-90, 90],
                        "default": 20,
                        "description": "Where to.",
                    },
                    "times": {"type": "Int32", "range": [1, 5]},
                    "how": {"type": "String", "default": "slowly"},
                },
                "results": {"reached": {"type": "Double", "unit": "deg"}, "count": {"type": "UInt16"}},
                "timeout_s": 30,
                "limits": {"least_interval_s": 2, "requests_at_once": 2, "largest_message_bytes": 100},
            },
            "blink": {"id": 1501, "immediate": True, "limits": {"visible_to": [7]}},
        },
    }
}


def model() -> FleetModel:
    return fleet_model(fleet_config(ROBOTS))


def said(*executions: ExecutionStatus, timestamp: int = 50, status: int | None = None) -> DataReceived:
    """A SkillStatus with these executions."""
    shown = SkillStatus()
    for execution in executions:
        shown.show(execution)
    types, values = shown.fields()
    message = DataSetMessage(STATUS.id, types=types, values=values, timestamp=timestamp, status=status)
    return DataReceived(STATUS, message, metadata_of(*SKILL_STATUS_FIELDS, name="SkillStatus"))
