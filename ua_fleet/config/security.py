"""Message security of a fleet, from its `fleet.yaml`: who needs which keys, and what secures a process's datagrams."""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Sequence
from pathlib import Path
from random import Random
from typing import Final

from ua_fleet.config.connections import barred_on, connection_numbers, needs_keys
from ua_fleet.config.relays import (
    RELAY_SPACE,
    relay_connections,
    relay_groups,
    relays_of_publishers,
    speakers_on,
)
from ua_fleet.config.schema import FleetConfig, PubSubConfig, PubSubSecurity
from ua_fleet.config.teleoperation import setpoint_groups
from ua_fleet.counters import Counters
from ua_fleet.errors import ConfigError
from ua_fleet.keys.files import FileKeySource
from ua_fleet.keys.source import KeySource
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.groups import command_group, relay_group, telemetry_group
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.storage.nonces import FileNonces
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.transport.mqtt.address import parse_broker_url
from ua_fleet.wire.security import SecurityMode, SecurityPolicy

__all__ = [
    "all_groups",
    "envelope_of",
    "envelopes_of",
    "file_keys_of",
    "groups_of",
    "keys_for",
    "keys_needed",
    "publisher_ids",
    "relay_envelopes",
    "relay_keys_of",
    "security_mode_of",
    "weaknesses",
]

MOST_BROKERED_BYTES: Final = 256 * 1024
"""Larger messages go over a broker as chunks. What it retains is one message, so that this is far more than what UDP
carries; brokers take 1 MB at least, as they are delivered."""
_MODES: Final = {
    PubSubSecurity.NONE: SecurityMode.NONE,
    PubSubSecurity.BROKER: SecurityMode.NONE,
    PubSubSecurity.SIGN: SecurityMode.SIGN,
    PubSubSecurity.SIGN_AND_ENCRYPT: SecurityMode.SIGN_AND_ENCRYPT,
}


def publisher_ids(config: FleetConfig) -> PublisherIds | None:
    """The PublisherIds of those bridges that have one of their own; None where there is none."""
    ids = {bridge.space: bridge.wire_id for bridge in config.bridges.values() if bridge.wire_id is not None}
    return PublisherIds(ids) if ids else None


def security_mode_of(connection: PubSubConfig) -> SecurityMode:
    """The MessageSecurityMode of a connection."""
    return _MODES[connection.security]


def all_groups(config: FleetConfig) -> tuple[str, ...]:
    """Every SecurityGroup of a fleet: the server's data, the data and the commands of each bridge, and relays."""
    groups = [telemetry_group(SERVER_SPACE)]
    for bridge in config.bridges.values():
        groups += [telemetry_group(bridge.space), command_group(bridge.space)]
    return (*groups, *map(relay_group, config.relays))


def groups_of(config: FleetConfig, space: int) -> tuple[str, ...]:
    """The groups whose keys the process of a space needs, the one that it publishes with first.

    These are the data of all, its own commands, the commands of those that name it as a requestor, and what relays send
    to its connections.
    """
    bridges = config.bridges.values()
    data = [telemetry_group(other) for other in (space, SERVER_SPACE, *(bridge.space for bridge in bridges))]
    commands = [command_group(bridge.space) for bridge in bridges if space in (bridge.space, *bridge.requestors)]
    by_relays = [
        relay_group(name) for number in connection_numbers(config, space) for name in speakers_on(config, number)
    ]
    return tuple(dict.fromkeys(data + commands + by_relays))


def envelopes_of(config: FleetConfig, space: int, counters: Counters, state_dir: Path) -> list[Envelope]:
    """`envelope_of` for each connection of a process, in their order."""
    seed = secrets.randbits(64)  # one for all, so that each knows the nonces of this process
    return [
        envelope_of(config, space, counters, state_dir, number=number, random=Random(seed))  # noqa: S311 - as in Envelope
        for number in connection_numbers(config, space)
    ]


def envelope_of(
    config: FleetConfig,
    space: int,
    counters: Counters,
    state_dir: Path,
    *,
    number: int = 0,
    random: Random | None = None,
) -> Envelope:
    """What secures the datagrams of the process of a space on a connection; it has no keys yet.

    Args:
        config: the fleet.
        space: the PublisherId of the process.
        counters: those of the process.
        state_dir: where the process remembers which nonces it has used. Not touched without message security.
        number: of the connection.
        random: where the random part of nonces comes from.

    Raises:
        ConfigError: what stands in that folder cannot be used.
    """
    barred = {make(other) for other in barred_on(config, number) for make in (telemetry_group, command_group)}
    # What relays send is wanted where they send it.
    wanted = [one for one in groups_of(config, space) if one not in barred and not one.startswith(relay_group(""))]
    return _envelope(config, space, counters, state_dir, number, wanted, random)


def _envelope(
    config: FleetConfig,
    space: int,
    counters: Counters,
    state_dir: Path,
    number: int,
    wanted: Iterable[str],
    random: Random | None,
    speaks_under: str | None = None,
) -> Envelope:
    pubsub = config.connections[number]
    mode = _MODES[pubsub.security]
    is_secured = mode is not SecurityMode.NONE
    envelope = Envelope(
        space,
        counters,
        mode=mode,
        nonces=FileNonces(state_dir) if is_secured else MemoryNonces(),
        relaxed_replay=pubsub.relaxed_replay,
        max_datagram_bytes=_most_bytes(pubsub),
        max_message_bytes=pubsub.max_message_bytes,
        past_keys=pubsub.keys.past_keys,
        asks_for_all=pubsub.keys.source == "files",
        setpoint_groups=setpoint_groups(config),
        publisher_ids=publisher_ids(config),
        relayed=relays_of_publishers(config, number),
        speaks_under=speaks_under,
        random=random,
    )
    for group_id in wanted if is_secured else ():
        envelope.want(group_id)
    return envelope


def relay_envelopes(config: FleetConfig, name: str, counters: Counters, state_dir: Path) -> list[Envelope]:
    """What secures the datagrams of a relay, for each of its connections; raises ConfigError as `envelope_of`."""
    seed = secrets.randbits(64)
    own, *groups = relay_groups(config, name)
    wanted = [group_id for group_id in groups if not group_id.startswith(relay_group(""))]
    return [
        _envelope(config, RELAY_SPACE, counters, state_dir, number, wanted, Random(seed), own)  # noqa: S311 - as above
        for number in relay_connections(config, name)
    ]


def _most_bytes(pubsub: PubSubConfig) -> int:
    """Of a message that is not sent as chunks, which JSON has none of."""
    if pubsub.is_json:
        return pubsub.max_message_bytes
    return MOST_BROKERED_BYTES if pubsub.is_brokered else pubsub.max_datagram_bytes


def file_keys_of(config: FleetConfig, space: int, config_dir: Path) -> FileKeySource:
    """The key files of a fleet; raises ConfigError where the process of a space cannot begin with them."""
    return _key_files(config, groups_of(config, space), config_dir)


def relay_keys_of(config: FleetConfig, name: str, config_dir: Path) -> FileKeySource:
    """The same of a relay."""
    return _key_files(config, relay_groups(config, name), config_dir)


def _key_files(config: FleetConfig, groups: Sequence[str], config_dir: Path) -> FileKeySource:
    keys = config.pubsub.keys
    source = FileKeySource(config_dir / keys.folder, SecurityPolicy.named(keys.policy))
    own, *others = groups
    source.check([own], others)
    return source


def keys_needed(config: FleetConfig, space: int, keys: KeySource | None) -> KeySource | None:
    """The source of keys that a process has to ask: the one it was given, or none without message security.

    A process whose connections have none has nothing to wait for, though others of the fleet have.

    Raises ConfigError where messages are to be secured and there is nobody to get keys from.
    """
    return keys_for(config.connections, keys) if needs_keys(config, space) else None


def keys_for(connections: Iterable[PubSubConfig], keys: KeySource | None) -> KeySource | None:
    """The same for who is on these connections."""
    secured = next((each for each in connections if each.is_secured), None)
    if secured is None:
        return None
    if keys is None:
        raise ConfigError(
            f"messages are to be secured ({secured.security.value}), and no key source is configured",
            key="pubsub.keys",
            suggestion="name one, or accept unsecured messages with `security: none`",
        )
    return keys


def weaknesses(config: FleetConfig) -> list[str]:
    """What of the configuration weakens message security, for the log of each process."""
    return [weakness for connection in config.connections for weakness in _weaknesses_of(config, connection)]


def _weaknesses_of(config: FleetConfig, pubsub: PubSubConfig) -> list[str]:
    reach = f"anyone who reaches {pubsub.url} on {pubsub.interface}"
    if pubsub.is_brokered:
        reach = f"anyone whom the broker {pubsub.url} allows to read and write these topics"
    if pubsub.security is PubSubSecurity.BROKER:
        return _weaknesses_of_json(pubsub)
    if pubsub.security is PubSubSecurity.NONE:
        driven = [name for name, robot in config.robots.items() if robot.teleoperation is not None]
        more = f", and drive {', '.join(driven)}" if driven else ""
        return [f"PubSub messages are neither signed nor encrypted: {reach} can read and forge them{more}"]
    found: list[str] = []
    if pubsub.security is PubSubSecurity.SIGN:
        found.append(f"PubSub messages are signed and not encrypted: {reach} can read them")
    if pubsub.relaxed_replay:
        spaces = ", ".join(map(str, pubsub.relaxed_replay))
        found.append(f"PubSub messages of these spaces are taken without a check for replays: {spaces}")
    return found


def _weaknesses_of_json(pubsub: PubSubConfig) -> list[str]:
    if parse_broker_url(pubsub.url).has_tls:
        return []  # that was asked for, and there is what protects it
    may = "can forge them, and command robots" if pubsub.actions else "can forge them"
    road = f"anyone on the network to {pubsub.url}, and anyone whom the broker allows to write these topics"
    return [f"PubSub messages are JSON without TLS: {road}, reads them and {may}"]
