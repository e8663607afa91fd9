"""A fleet over several PubSub connections: which process is on which, and what comes by which.

The loop rule looks at a message's origin, and so holds whatever it came by. What is decided here is narrower: a space
whose bridge `fleet.yaml` names comes only by the connections of that bridge, so that nobody speaks for it on another
one, which may be less protected.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from ua_fleet.config.pubsub_schema import PubSubConfig
from ua_fleet.config.schema import FleetConfig
from ua_fleet.topics import SERVER_SPACE

__all__ = [
    "OF_ALL",
    "FleetOfConnections",
    "action_routes",
    "barred_on",
    "connection_numbers",
    "needs_keys",
    "over_one",
    "takes_actions",
    "unstartable",
]

OF_ALL: Final = ("keep_alive_s", "receive_timeout_s", "repeat_interval_s", "inlet_size", "max_wait_s", "keys")
"""What holds for all connections, and stands in the first one."""
_MOST_NAMED: Final = 5


class FleetOfConnections(FleetConfig, frozen=True):
    """A `fleet.yaml` whose `pubsub` is a list; its first connection is `pubsub` here."""

    further: tuple[PubSubConfig, ...] = ()
    """The others."""

    @property
    def connections(self) -> tuple[PubSubConfig, ...]:
        """All of them, in the order of the file."""
        return (self.pubsub, *self.further)


def over_one(config: FleetConfig, number: int) -> FleetConfig:
    """The fleet as it is over one of its connections alone, for a tool that listens there."""
    if not isinstance(config, FleetOfConnections):
        return config
    return config.model_copy(update={"pubsub": config.connections[number], "further": ()})


def connection_numbers(config: FleetConfig, space: int) -> tuple[int, ...]:
    """The places in `config.connections` of those that the process of a space is on."""
    count = len(config.connections)
    if count == 1:
        return (0,)
    if space == SERVER_SPACE:
        return _numbers(config, config.server.connections) or tuple(range(count))
    names = [bridge.connections for bridge in config.bridges.values() if bridge.space == space]
    return _numbers(config, names[0] if names else ()) or (0,)


def _numbers(config: FleetConfig, names: tuple[str, ...]) -> tuple[int, ...]:
    places = {connection.name: number for number, connection in enumerate(config.connections)}
    return tuple(sorted(places[name] for name in names))


def needs_keys(config: FleetConfig, space: int) -> bool:
    """Whether the process of a space is on a connection with message security."""
    return any(config.connections[number].is_secured for number in connection_numbers(config, space))


def barred_on(config: FleetConfig, number: int) -> frozenset[int]:
    """The spaces of the fleet whose processes are not on a connection: nobody speaks for them there."""
    if len(config.connections) == 1:
        return frozenset()
    spaces = [SERVER_SPACE, *(bridge.space for bridge in config.bridges.values())]
    return frozenset(space for space in spaces if number not in connection_numbers(config, space))


def takes_actions(config: FleetConfig, space: int, number: int) -> bool:
    """Whether the process of a space takes and sends Actions on a connection.

    Not by one without message security where it has another one with it: that would be the way around the keys.
    """
    connection = config.connections[number]
    if connection.is_json and not connection.actions:
        return False
    return connection.is_secured or not needs_keys(config, space)


def _takes_any(config: FleetConfig, space: int) -> bool:
    return any(takes_actions(config, space, number) for number in connection_numbers(config, space))


def unstartable(config: FleetConfig) -> list[str]:
    """Which robots have skills that nobody can start, since Actions go over no connection of their bridge; a line."""
    robots = [
        name for name, robot in config.robots.items() if robot.skills and not _takes_any(config, config.space_of(name))
    ]
    more = f" and {len(robots) - _MOST_NAMED} more" if len(robots) > _MOST_NAMED else ""
    named = ", ".join(robots[:_MOST_NAMED]) + more
    return [f"skills of {named} cannot be started: their PubSub is JSON without `actions: true`"] if robots else []


def action_routes(config: FleetConfig, space: int) -> Mapping[int, tuple[int, ...]]:
    """For each bridge, by its space: which of the connections of the process of `space` Actions for it go by.

    The numbers are places among the process's own connections.
    """
    on = connection_numbers(config, space)
    routes: dict[int, tuple[int, ...]] = {}
    for bridge in config.bridges.values():
        theirs = connection_numbers(config, bridge.space)
        routes[bridge.space] = tuple(
            place
            for place, number in enumerate(on)
            if number in theirs and takes_actions(config, space, number) and takes_actions(config, bridge.space, number)
        )
    return routes
