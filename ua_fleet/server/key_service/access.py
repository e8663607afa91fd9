"""Which space may have the keys of which SecurityGroup: pure, from `fleet.yaml`.

t-<space>   that space publishes, all others read: everybody has its keys
c-<space>   commands to that space: it, and the spaces that its `requestors` name
r-<relay>   what that relay forwards: it, and who is on a connection that it sends to

Space 0 is the server's. Nobody but the server, the bridges and the relays of `fleet.yaml` has any keys. A relay has
those of the data that it forwards, and no commands'.
"""

from __future__ import annotations

from ua_fleet.config.relays import relay_groups
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups, groups_of
from ua_fleet.topics import SERVER_SPACE

__all__ = ["KeyAccess"]


class KeyAccess:
    """The SecurityGroups of a fleet, and who has their keys."""

    def __init__(self, config: FleetConfig) -> None:
        self.group_ids = all_groups(config)
        """All SecurityGroupIds."""
        self._spaces = {name: bridge.space for name, bridge in config.bridges.items()}
        self._relays = {name: frozenset(relay_groups(config, name)) for name in config.relays}
        self._groups = {space: frozenset(groups_of(config, space)) for space in (SERVER_SPACE, *self._spaces.values())}

    def space_may(self, space: int, group_id: str) -> bool:
        """Whether a space may have a group's keys."""
        return group_id in self._groups.get(space, ())

    def bridge_may(self, name: str, group_id: str) -> bool:
        """Whether a bridge, or a relay, may have a group's keys; one that `fleet.yaml` does not name may have none."""
        if (groups := self._relays.get(name)) is not None:
            return group_id in groups
        space = self._spaces.get(name)
        return space is not None and self.space_may(space, group_id)
