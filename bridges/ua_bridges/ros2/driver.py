"""The entry of the ROS 2 bridge."""

from __future__ import annotations

from ua_bridges.ros.skills import skill_specs
from ua_fleet.bridge.driver import Driver
from ua_fleet.config.schema import FleetConfig

__all__ = ["create_driver"]


def create_driver(config: FleetConfig, bridge_name: str) -> Driver:
    """The driver of the ROS 2 bridge with this name in `fleet.yaml`. rclpy is loaded when it starts."""
    from ua_bridges.ros2.session import Ros2Driver
    from ua_bridges.ros2.skills.driver import SkilledRos2Driver

    specs = skill_specs(config, bridge_name)
    return SkilledRos2Driver(config, bridge_name, specs) if specs else Ros2Driver(config, bridge_name)
