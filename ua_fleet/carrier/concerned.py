"""What of a fleet concerns the bridge that carries a run: so a bridge of a large fleet does not grow with it."""

from __future__ import annotations

from ua_fleet.config.schema import FleetConfig

__all__ = ["fleet_around"]


def fleet_around(config: FleetConfig, space: int) -> FleetConfig:
    """The robots of a bridge, those that it may command, and those with values that conditions may be about.

    Args:
        config: the whole fleet.
        space: of the bridge.
    """

    def concerns(bridge: str) -> bool:
        known = config.bridges.get(bridge)
        return known is not None and (known.space == space or space in known.requestors)

    robots = {name: robot for name, robot in config.robots.items() if robot.data or concerns(robot.bridge)}
    behind = {robot.bridge for robot in robots.values()}
    bridges = {name: one for name, one in config.bridges.items() if one.space == space or name in behind}
    return config.model_copy(update={"robots": robots, "bridges": bridges})
