"""Configuration of a ROS 1 bridge in `fleet.yaml`."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from ua_bridges.ros.bridge_config import RosBridgeConfig

__all__ = ["Ros1BridgeConfig"]


class Ros1BridgeConfig(RosBridgeConfig, frozen=True):
    """A bridge into the graph of a ROS 1 master."""

    kind: Literal["ros1"]
    """Always `ros1`."""
    space: Literal[1] = 1
    """ROS 1 is space 1."""
    master_uri: Annotated[str, Field(pattern=r"^http://[^/]+:\d{1,5}/?$")] = "http://127.0.0.1:11311"
    """XML-RPC address of the ROS master (ROS_MASTER_URI)."""
    host_ip: str = "127.0.0.1"
    """Address under which other ROS nodes reach this bridge (ROS_IP)."""

    ros: ClassVar[Literal[1, 2]] = 1
