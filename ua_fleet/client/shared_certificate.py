"""Two bridges with one `state_dir`: the certificate there is that of the first one, and the server knows one by it."""

from __future__ import annotations

from pathlib import Path

from ua_fleet.client.identity import ClientIdentity
from ua_fleet.client.known_servers import application_uri_of
from ua_fleet.config.schema import FleetConfig
from ua_fleet.pubsub.application import bridge_application_uri

__all__ = ["why_not_its_own"]


def why_not_its_own(config: FleetConfig, config_dir: Path, name: str) -> str:
    """Why the certificate in the folder of a bridge or relay is not its own; empty where it is, or none is there.

    One of a name that is not in the file any more is its own: it was renamed, or the fleet was.
    """
    folder = config_dir / config.state_dir_of(name)
    identity = ClientIdentity.of_bridge(folder, config.fleet.name, name)
    others = {
        bridge_application_uri(config.fleet.name, other): other
        for other in (*config.bridges, *config.relays)
        if other != name
    }
    try:
        data = identity.certificate.read_bytes()
    except FileNotFoundError:
        return ""
    owner = others.get(application_uri_of(data))
    if owner is None:
        return ""
    return (
        f"{identity.certificate}: is the certificate of {owner}, and one certificate is that of one bridge; "
        f"give {name} a state_dir of its own in fleet.yaml"
    )
