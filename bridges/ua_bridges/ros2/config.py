"""Configuration of a ROS 2 bridge in `fleet.yaml`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, Field, field_validator

from ua_bridges.ros.installed import ros_type_problems
from ua_bridges.ros.skills import RosSkillMapping, skill_problems
from ua_bridges.ros.type_checks import message_type_findings
from ua_fleet.config.schema import BridgeConfig, DataMapping, MachineFinding, RobotConfig, TopicMapping
from ua_fleet.document import KeyPath
from ua_fleet.errors import TopicInvalid
from ua_fleet.topics import LAST_ROS2_SPACE, ROS1_SPACE, check_ros2_space

__all__ = ["Ros2BridgeConfig"]


class Ros2BridgeConfig(BridgeConfig, frozen=True):
    """A bridge into a ROS 2 domain. `space` is the domain id; 2..101 keep clear of Linux's ephemeral ports."""

    kind: Literal["ros2"]
    """Always `ros2`."""
    space: int = Field(json_schema_extra={"minimum": ROS1_SPACE + 1, "maximum": LAST_ROS2_SPACE})
    """Id of the ROS 2 domain, 2 to 232; 2 to 101 keep clear of Linux's ephemeral ports."""
    node_name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")] = "ua_bridge"
    """Name of the bridge's node in the graph."""
    discovery: Literal["localhost", "subnet"] = "localhost"
    """How far DDS discovery reaches (ROS_AUTOMATIC_DISCOVERY_RANGE)."""

    skill_mapping: ClassVar[type[BaseModel] | None] = RosSkillMapping
    """Model of `via` in the skills of its robots."""
    source_mapping: ClassVar[type[DataMapping] | None] = TopicMapping
    sink_mapping: ClassVar[type[DataMapping] | None] = TopicMapping
    takes_setpoints: ClassVar[bool] = True

    @field_validator("space")
    @classmethod
    def _domain(cls, space: int) -> int:
        try:
            return check_ros2_space(space)
        except TopicInvalid as error:
            raise ValueError(error.reason) from error

    def problems(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, str, str]]:
        """See BridgeConfig."""
        return skill_problems(robots)

    def fleet_problems(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, str, str]]:
        """See BridgeConfig."""
        yield from super().fleet_problems(name, robots)
        yield from ros_type_problems(robots, name)

    def findings_here(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, MachineFinding]]:
        """See BridgeConfig."""
        return message_type_findings(robots, name, 2)
