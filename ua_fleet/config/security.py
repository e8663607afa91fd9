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
    groups = [telemetry_group(space)]
    for bridge in config.bridges.values():
        if bridge.space == space or space in bridge.requestors:
            groups.append(command_group(bridge.space))
    groups += [group_id for group_id in all_groups(config) if group_id.startswith("t") and group_id not in groups]
    return tuple(groups)
