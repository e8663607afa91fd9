"""Configuration of a ROS 2 bridge in `fleet.yaml`."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field, field_validator

from ua_bridges.ros.bridge_config import RosBridgeConfig
from ua_fleet.errors import TopicInvalid
from ua_fleet.topics import LAST_ROS2_SPACE, ROS1_SPACE, check_ros2_space

__all__ = ["Ros2BridgeConfig"]


class Ros2BridgeConfig(RosBridgeConfig, frozen=True):
    """A bridge into a ROS 2 domain. `space` is the domain id; 2..101 keep clear of Linux's ephemeral ports."""

    kind: Literal["ros2"]
    """Always `ros2`."""
    space: int = Field(json_schema_extra={"minimum": ROS1_SPACE + 1, "maximum": LAST_ROS2_SPACE})
    """Id of the ROS 2 domain, 2 to 232; 2 to 101 keep clear of Linux's ephemeral ports."""
    discovery: Literal["localhost", "subnet"] = "localhost"
    """How far DDS discovery reaches (ROS_AUTOMATIC_DISCOVERY_RANGE)."""

    ros: ClassVar[Literal[1, 2]] = 2

    @field_validator("space")
    @classmethod
    def _domain(cls, space: int) -> int:
        try:
            return check_ros2_space(space)
        except TopicInvalid as error:
            raise ValueError(error.reason) from error
