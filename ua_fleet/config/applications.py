"""What the processes of a fleet say of themselves in discovery, from its `fleet.yaml`."""

from __future__ import annotations

from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import publisher_ids, security_mode_of
from ua_fleet.pubsub.application import Application, bridge_application_uri, describe, server_application_uri
from ua_fleet.pubsub.security.groups import command_group, telemetry_group
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.wire.discovered import ApplicationDescription, EndpointDescription
from ua_fleet.wire.security import SecurityMode

__all__ = ["bridge_application", "server_application"]


def bridge_application(config: FleetConfig, bridge_name: str) -> Application:
    """A bridge. It has no OPC UA Server, so no Endpoints."""
    description = describe(bridge_application_uri(config.fleet.name, bridge_name), f"bridge {bridge_name}")
    return _application(config, config.bridges[bridge_name].space, description)


def server_application(config: FleetConfig, endpoints: tuple[EndpointDescription, ...] = ()) -> Application:
    """The fleet's server with its Endpoints, which are known once it runs."""
    urls = tuple(dict.fromkeys([endpoint.endpoint_url or "" for endpoint in endpoints]))
    uri = server_application_uri(config.fleet.name)
    description = describe(uri, f"{config.fleet.name} server", is_server=True, discovery_urls=urls)
    return _application(config, SERVER_SPACE, description, ("DA",), endpoints)


def _application(
    config: FleetConfig,
    space: int,
    description: ApplicationDescription,
    capabilities: tuple[str, ...] = (),
    endpoints: tuple[EndpointDescription, ...] = (),
) -> Application:
    pubsub, mode = config.pubsub, security_mode_of(config)
    is_secured = mode is not SecurityMode.NONE
    ids = publisher_ids(config)
    return Application(
        description,
        capabilities=capabilities,
        endpoints=endpoints,
        publisher_id=None if ids is None else ids.variant(space),
        url=pubsub.url,
        network_interface=pubsub.interface,
        security_mode=mode.value,
        data_group=telemetry_group(space) if is_secured else None,
        command_group=command_group(space) if is_secured else None,
        max_message_bytes=pubsub.max_message_bytes,
    )
