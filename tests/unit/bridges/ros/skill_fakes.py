"""Message objects and specifications of skills without ROS."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from ua_bridges.ros.schema import MessageSchema, schema_from_definition
from ua_bridges.ros.skills import RosSkillMapping, SkillSpec

from ua_fleet.config.schema import SkillConfig
from ua_fleet.topics import Topic

DEFINITION = """\
float64 speed
int32 count
string text
Pose pose
float64[] values
===
MSG: robot_msgs/Pose
float64 x
"""
SCHEMA: MessageSchema = schema_from_definition("robot_msgs/State", DEFINITION)


def state(**members: Any) -> Any:
    """A message robot_msgs/State."""
    pose = SimpleNamespace(x=members.pop("x", 0.0))
    return SimpleNamespace(**{"speed": 0.0, "count": 0, "text": "", "values": [], "pose": pose, **members})


def spec_of(via: dict[str, Any] | None = None, **skill: Any) -> SkillSpec:
    """The skill `carrier.go`."""
    config = SkillConfig.model_validate({"id": 5, "via": via or {}, **skill})
    mapping = RosSkillMapping.model_validate(via) if via else None
    return SkillSpec("carrier", "go", Topic(2, 2, 5), Topic(2, 2, 6), config, mapping)
