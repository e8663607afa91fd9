"""A bridge and a server on one machine made known to each other."""

from __future__ import annotations

from pathlib import Path

from ua_fleet.client import ClientIdentity
from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.certificates import (
    CertificateFiles,
    ensure_application_certificate,
    own_files,
    trust_bridge,
)
from ua_fleet.server.app import application_uri
from ua_fleet.storage.files import write_whole

__all__ = ["introduce_bridge", "renew_server"]


async def introduce_bridge(config: FleetConfig, config_dir: Path, name: str, *, renew: bool = False) -> None:
    """Make the certificates of both where they are missing; the server knows the bridge, the bridge no other server.

    Args:
        config: the fleet.
        config_dir: folder of its `fleet.yaml`.
        name: of the bridge.
        renew: make the bridge's certificate anew.
    """
    identity = ClientIdentity.of_bridge(config_dir / config.state_dir_of(name), config.fleet.name, name)
    await (identity.renew() if renew else identity.ensure())
    folder = config_dir / config.server.state_dir
    trust_bridge(folder, name, identity.certificate)
    server = ensure_application_certificate(folder, application_uri(config), [config.server.host])
    write_whole(identity.pinned_server, server.certificate.read_bytes())


def renew_server(config: FleetConfig, config_dir: Path) -> tuple[CertificateFiles, list[str]]:
    """Make the server's certificate anew, with the key that there is.

    Bridges of this machine that had pinned the old one have the new one from now on.

    Returns:
        Its files, and the names of those bridges.
    """
    folder = config_dir / config.server.state_dir
    old = own_files(folder).certificate
    before = old.read_bytes() if old.exists() else b""
    files = ensure_application_certificate(folder, application_uri(config), [config.server.host], renew=True)
    pinned: list[str] = []
    for name in (*config.bridges, *config.relays):
        identity = ClientIdentity.of_bridge(config_dir / config.state_dir_of(name), config.fleet.name, name)
        if before and identity.pinned_server.exists() and identity.pinned_server.read_bytes() == before:
            write_whole(identity.pinned_server, files.certificate.read_bytes())
            pinned.append(name)
    return files, pinned
