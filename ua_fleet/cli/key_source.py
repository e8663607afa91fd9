"""Where a bridge's keys come from, as `fleet.yaml` says."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from ua_fleet.cli.endings import extra_needed
from ua_fleet.transport.addresses import host_and_port

if TYPE_CHECKING:
    from ua_fleet.config import FleetConfig
    from ua_fleet.keys.source import KeySource

__all__ = ["key_source_of", "relay_key_source_of", "service_endpoint", "service_keys_of"]

_THIS_MACHINE = {"0.0.0.0": "127.0.0.1", "::": "::1"}
"""Where one asks a server of this machine that listens on all addresses."""


def service_endpoint(config: FleetConfig) -> str:
    """URL of the key service."""
    server = config.server
    place = host_and_port(_THIS_MACHINE.get(server.host, server.host), server.port)
    return config.pubsub.keys.endpoint or f"opc.tcp://{place}/{server.path}"


def key_source_of(
    config: FleetConfig, bridge_name: str, config_dir: Path, state_dir: Path
) -> AbstractAsyncContextManager[KeySource | None]:
    """The source of a bridge's keys, to be open while the bridge runs; of None without message security.

    Raises:
        ConfigError: the bridge cannot begin with its key files.
        BridgeUnavailable: keys come from the service, and its client is not installed.
    """
    from ua_fleet.config.connections import needs_keys
    from ua_fleet.config.security import file_keys_of

    space = config.bridges[bridge_name].space
    if not needs_keys(config, space):
        return nullcontext()
    if config.pubsub.keys.source == "files":
        return nullcontext(file_keys_of(config, space, config_dir))
    return service_keys_of(config, bridge_name, state_dir)


def relay_key_source_of(
    config: FleetConfig, name: str, config_dir: Path, state_dir: Path
) -> AbstractAsyncContextManager[KeySource | None]:
    """The same of a relay's keys."""
    from ua_fleet.config.relays import relay_connections
    from ua_fleet.config.security import relay_keys_of

    if not any(config.connections[number].is_secured for number in relay_connections(config, name)):
        return nullcontext()
    if config.pubsub.keys.source == "files":
        return nullcontext(relay_keys_of(config, name, config_dir))
    return service_keys_of(config, name, state_dir)


def service_keys_of(config: FleetConfig, bridge_name: str, state_dir: Path) -> AbstractAsyncContextManager[KeySource]:
    """The key service, asked with a bridge's certificate; raises BridgeUnavailable without its client."""
    with extra_needed("the key service", "client"):
        from ua_fleet.client.identity import ClientIdentity
        from ua_fleet.client.key_source import ServiceKeySource
    identity = ClientIdentity.of_bridge(state_dir, config.fleet.name, bridge_name)
    return ServiceKeySource(service_endpoint(config), identity, bridge_name)
