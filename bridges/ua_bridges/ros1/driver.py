"""The entry of the ROS 1 bridge."""

from __future__ import annotations

from ua_bridges.ros.skills import skill_specs
from ua_fleet.bridge.driver import Driver
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import BridgeUnavailable
from ua_fleet.printing import config_option

__all__ = ["create_driver"]


def create_driver(config: FleetConfig, bridge_name: str) -> Driver:
    """The driver of the ROS 1 bridge with this name in `fleet.yaml`.

    Raises:
        BridgeUnavailable: this Python has no rospy.
    """
    try:
        from ua_bridges.ros1.session import Ros1Driver  # rospy, only where it is wanted
        from ua_bridges.ros1.skills.driver import SkilledRos1Driver
    except ImportError as error:
        raise BridgeUnavailable(
            f"rospy cannot be imported ({error}); ROS 1 has an environment of its own (docs/install.md), in a clone: "
            f".venv-ros1/bin/ua-fleet bridge {bridge_name}{config_option()}"
        ) from error
    specs = skill_specs(config, bridge_name)
    return SkilledRos1Driver(config, bridge_name, specs) if specs else Ros1Driver(config, bridge_name)
