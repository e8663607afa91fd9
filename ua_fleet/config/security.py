"""Which SecurityGroups a fleet has, and which of them each process needs (OPC 10000-14 6.2.12.2)."""

from __future__ import annotations

from ua_fleet.config.schema import FleetConfig
from ua_fleet.pubsub.security.groups import command_group, telemetry_group
from ua_fleet.topics import SERVER_SPACE

__all__ = ["all_groups", "groups_of"]


def all_groups(config: FleetConfig) -> tuple[str, ...]:
    """Every SecurityGroup of a fleet: the server's data, then the data and the commands of each bridge."""
    groups = [telemetry_group(SERVER_SPACE)]
    for bridge in config.bridges.values():
        groups += [telemetry_group(bridge.space), command_group(bridge.space)]
    return tuple(groups)


def groups_of(config: FleetConfig, space: int) -> tuple[str, ...]:
    """The groups whose keys the process of a space needs, the one that it publishes with first.

    These are the data of all, its own commands, and the commands of those that name it as a requestor.
    """
    bridges = config.bridges.values()
    data = [telemetry_group(other) for other in (space, SERVER_SPACE, *(bridge.space for bridge in bridges))]
    commands = [command_group(bridge.space) for bridge in bridges if space in (bridge.space, *bridge.requestors)]
    return tuple(dict.fromkeys(data + commands))
