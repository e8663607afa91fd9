"""The relays of a fleet: what each of them forwards, and who hears an origin by which relay.

The list of origins stands in `fleet.yaml` once, for both ends. A relay forwards what it names. Who is on the target
takes that from the relay, under the relay's SecurityGroup, and from nobody else.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from ua_fleet.config.relay_schema import OriginName, RelayedConfig
from ua_fleet.config.schema import BridgeConfig, FleetConfig
from ua_fleet.pubsub.origins import NO_ORIGINS, Direction, Origins
from ua_fleet.pubsub.security.groups import relay_group, telemetry_group
from ua_fleet.topics import Topic

__all__ = [
    "RELAY_SPACE",
    "SOURCE_PREFIX",
    "directions_of",
    "origins_of",
    "origins_on",
    "relay_connections",
    "relay_groups",
    "relays_of_publishers",
    "speakers_on",
]

RELAY_SPACE: Final = 254
"""In place of the space of a relay, which has none: reserved (docs/topics.md), so that nobody else has it."""
SOURCE_PREFIX: Final = "ua_"
"""How an origin begins that is a single source."""


def origins_of(names: Iterable[OriginName], bridges: Mapping[str, BridgeConfig]) -> Origins:
    """The origins of these names; raises TopicInvalid or KeyError for what is none."""
    spaces: list[int] = []
    sources: list[Topic] = []
    for name in names:
        if isinstance(name, int):
            spaces.append(name)
        elif name.startswith(SOURCE_PREFIX) and name not in bridges:
            sources.append(Topic.parse(name))
        else:
            spaces.append(bridges[name].space)
    return Origins(spaces, sources)


def relay_connections(config: FleetConfig, name: str) -> tuple[int, ...]:
    """The places in `config.connections` of those that a relay is on."""
    named = {side for each in config.relays[name].forwards for side in (each.source, each.target)}
    return tuple([number for number, each in enumerate(config.connections) if each.name in named])


def directions_of(config: FleetConfig, name: str) -> list[Direction]:
    """What a relay forwards; the numbers are places among its own connections."""
    places = [config.connections[number].name for number in relay_connections(config, name)]
    return [
        Direction(places.index(each.source), places.index(each.target), origins_of(each.origins, config.bridges))
        for each in config.relays[name].forwards
    ]


def speakers_on(config: FleetConfig, number: int) -> dict[str, Origins]:
    """The relays that send to a connection, and whose data."""
    name = config.connections[number].name
    found: dict[str, Origins] = {}
    for relay, each in _forwards(config):
        if name is not None and each.target == name:
            found[relay] = found.get(relay, NO_ORIGINS) | origins_of(each.origins, config.bridges)
    return found


def _forwards(config: FleetConfig) -> Iterator[tuple[str, RelayedConfig]]:
    for name, relay in config.relays.items():
        for each in relay.forwards:
            yield name, each


def origins_on(config: FleetConfig, number: int) -> Origins:
    """What comes by a connection by relays alone."""
    found = NO_ORIGINS
    for origins in speakers_on(config, number).values():
        found |= origins
    return found


def relays_of_publishers(config: FleetConfig, number: int) -> dict[int, str]:
    """The SecurityGroups under which publishers are heard on a connection that are heard there by relays."""
    return {
        publisher: relay_group(relay)
        for relay, origins in speakers_on(config, number).items()
        for publisher in origins.publishers
    }


def relay_groups(config: FleetConfig, name: str) -> tuple[str, ...]:
    """The groups whose keys a relay needs, the one that it sends with first."""
    numbers = relay_connections(config, name)
    groups = [relay_group(name)]
    for direction in directions_of(config, name):
        number = numbers[direction.source]
        if config.connections[number].is_secured:
            by_relays = relays_of_publishers(config, number)
            publishers = sorted(direction.origins.publishers)
            groups += [by_relays.get(publisher) or telemetry_group(publisher) for publisher in publishers]
    return tuple(dict.fromkeys(groups))
