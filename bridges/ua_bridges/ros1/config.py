"""Configuration of a ROS 1 bridge in `fleet.yaml`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, Field

from ua_bridges.ros.installed import ros_type_problems
from ua_bridges.ros.skills import RosSkillMapping, skill_problems
from ua_bridges.ros.type_checks import message_type_findings
from ua_fleet.config.schema import BridgeConfig, DataMapping, MachineFinding, RobotConfig, TopicMapping
from ua_fleet.document import KeyPath

__all__ = ["Ros1BridgeConfig"]


class Ros1BridgeConfig(BridgeConfig, frozen=True):
    """A bridge into the graph of a ROS 1 master."""

    kind: Literal["ros1"]
    """Always `ros1`."""
    space: Literal[1] = 1
    """ROS 1 is space 1."""
    master_uri: Annotated[str, Field(pattern=r"^http://[^/]+:\d{1,5}/?$")] = "http://127.0.0.1:11311"
    """XML-RPC address of the ROS master (ROS_MASTER_URI)."""
    host_ip: str = "127.0.0.1"
    """Address under which other ROS nodes reach this bridge (ROS_IP)."""
    node_name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")] = "ua_bridge"
    """Name of the bridge's node in the graph."""

    skill_mapping: ClassVar[type[BaseModel] | None] = RosSkillMapping
    """Model of `via` in the skills of its robots."""
    source_mapping: ClassVar[type[DataMapping] | None] = TopicMapping
    sink_mapping: ClassVar[type[DataMapping] | None] = TopicMapping
    takes_setpoints: ClassVar[bool] = True

    def problems(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, str, str]]:
        """See BridgeConfig."""
        return skill_problems(robots)

    def fleet_problems(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, str, str]]:
        """See BridgeConfig."""
        yield from super().fleet_problems(name, robots)
        yield from ros_type_problems(robots, name)

    def findings_here(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, MachineFinding]]:
        """See BridgeConfig."""
        return message_type_findings(robots, name, 1)
