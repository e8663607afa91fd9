"""A bridge and a server on one machine made known to each other."""

from __future__ import annotations

from pathlib import Path

from ua_fleet.client import ClientIdentity
from ua_fleet.config.schema import FleetConfig
from ua_fleet.server.app import application_uri
from ua_fleet.server.certificates import ensure_application_certificate, trust_bridge, write_private

__all__ = ["introduce_bridge"]


async def introduce_bridge(config: FleetConfig, config_dir: Path, name: str) -> None:
    """Make the certificates of both where they are missing; the server knows the bridge, the bridge no other server.

    Args:
        config: the fleet.
        config_dir: folder of its `fleet.yaml`.
        name: of the bridge.
    """
    identity = ClientIdentity.of_bridge(config_dir / config.state_dir_of(name), config.fleet.name, name)
    await identity.ensure()
    folder = config_dir / config.server.state_dir
    trust_bridge(folder, name, identity.certificate)
    server = ensure_application_certificate(folder, application_uri(config), [config.server.host])
    write_private(identity.pinned_server, server.certificate.read_bytes())
