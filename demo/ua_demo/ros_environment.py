"""How a robot's program finds its ROS graph."""

from __future__ import annotations

from importlib.resources import files

__all__ = ["ros2_environment"]


def ros2_environment(domain: int, discovery: str) -> dict[str, str]:
    """What the environment of a program in ROS 2 has.

    Args:
        domain: its ROS 2 domain.
        discovery: how far it looks for others, `LOCALHOST` or `SUBNET`.
    """
    return {
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": discovery,
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(files("ua_bridges") / "ros2" / "profiles" / "robot.xml"),
    }
