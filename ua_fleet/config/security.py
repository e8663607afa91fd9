"""Message security of a fleet, from its `fleet.yaml`: who needs which keys, and what secures a process's datagrams."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from ua_fleet.config.schema import FleetConfig, PubSubSecurity
from ua_fleet.config.teleoperation import setpoint_groups
from ua_fleet.counters import Counters
from ua_fleet.errors import ConfigError
from ua_fleet.keys.files import FileKeySource
from ua_fleet.keys.source import KeySource
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.groups import command_group, telemetry_group
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.storage.nonces import FileNonces
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.wire.security import SecurityMode, SecurityPolicy

__all__ = [
    "all_groups",
    "envelope_of",
    "file_keys_of",
    "groups_of",
    "keys_needed",
    "publisher_ids",
    "security_mode_of",
    "weaknesses",
]

_MODES: Final = {
    PubSubSecurity.NONE: SecurityMode.NONE,
    PubSubSecurity.SIGN: SecurityMode.SIGN,
    PubSubSecurity.SIGN_AND_ENCRYPT: SecurityMode.SIGN_AND_ENCRYPT,
}


def publisher_ids(config: FleetConfig) -> PublisherIds | None:
    """The PublisherIds of those bridges that have one of their own; None where there is none."""
    ids = {bridge.space: bridge.wire_id for bridge in config.bridges.values() if bridge.wire_id is not None}
    return PublisherIds(ids) if ids else None


def security_mode_of(config: FleetConfig) -> SecurityMode:
    """The MessageSecurityMode of a fleet."""
    return _MODES[config.pubsub.security]


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


def envelope_of(config: FleetConfig, space: int, counters: Counters, state_dir: Path) -> Envelope:
    """What secures the datagrams of the process of a space; it has no keys yet.

    Args:
        config: the fleet.
        space: the PublisherId of the process.
        counters: those of the process.
        state_dir: where the process remembers which nonces it has used. Not touched without message security.

    Raises:
        ConfigError: what stands in that folder cannot be used.
    """
    pubsub, mode = config.pubsub, _MODES[config.pubsub.security]
    is_secured = mode is not SecurityMode.NONE
    envelope = Envelope(
        space,
        counters,
        mode=mode,
        nonces=FileNonces(state_dir) if is_secured else MemoryNonces(),
        relaxed_replay=pubsub.relaxed_replay,
        max_datagram_bytes=pubsub.max_datagram_bytes,
        max_message_bytes=pubsub.max_message_bytes,
        past_keys=pubsub.keys.past_keys,
        asks_for_all=pubsub.keys.source == "files",
        setpoint_groups=setpoint_groups(config),
        publisher_ids=publisher_ids(config),
    )
    for group_id in groups_of(config, space) if is_secured else ():
        envelope.want(group_id)
    return envelope


def file_keys_of(config: FleetConfig, space: int, config_dir: Path) -> FileKeySource:
    """The key files of a fleet; raises ConfigError where the process of a space cannot begin with them."""
    keys = config.pubsub.keys
    source = FileKeySource(config_dir / keys.folder, SecurityPolicy.named(keys.policy))
    own, *others = groups_of(config, space)
    source.check([own], others)
    return source


def keys_needed(config: FleetConfig, keys: KeySource | None) -> KeySource | None:
    """The source of keys that a process has to ask: the one it was given, or none without message security.

    Raises ConfigError where messages are to be secured and there is nobody to get keys from.
    """
    if config.pubsub.security is PubSubSecurity.NONE:
        return None
    if keys is None:
        raise ConfigError(
            f"messages are to be secured ({config.pubsub.security.value}), and no key source is configured",
            key="pubsub.keys",
            suggestion="name one, or accept unsecured messages with `security: none`",
        )
    return keys


def weaknesses(config: FleetConfig) -> list[str]:
    """What of the configuration weakens message security, for the log of each process."""
    pubsub = config.pubsub
    reach = f"whoever reaches {pubsub.url} on {pubsub.interface}"
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
