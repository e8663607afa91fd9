"""What the processes of a fleet say of themselves in discovery, from its `fleet.yaml`."""

from __future__ import annotations

from dataclasses import replace

from ua_fleet.config.connections import connection_numbers, takes_actions
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
    numbers = connection_numbers(config, space)
    on = [config.connections[number] for number in numbers]
    ids = publisher_ids(config)
    whole = Application(
        description,
        capabilities=capabilities,
        endpoints=endpoints,
        is_brokered=any(each.is_brokered for each in on),
        is_also_grouped=0 < sum(each.is_brokered for each in on) < len(on),
        publisher_id=None if ids is None else ids.variant(space),
        max_message_bytes=min(each.max_message_bytes for each in on),
    )
    first, *further = [_connected(config, whole, space, number) for number in numbers]
    return replace(first, further=tuple(further))


def _connected(config: FleetConfig, whole: Application, space: int, number: int) -> Application:
    """A process as one of its PubSubConnections shows it."""
    pubsub = config.connections[number]
    mode = security_mode_of(pubsub)
    is_secured = mode is not SecurityMode.NONE
    has_several = len(connection_numbers(config, space)) > 1
    return replace(
        whole,
        json_form=pubsub.json_form.form if pubsub.is_json else None,
        url=pubsub.url,
        network_interface=pubsub.interface,
        security_mode=mode.value,
        data_group=telemetry_group(space) if is_secured else None,
        command_group=command_group(space) if is_secured else None,
        connection_name=(pubsub.name or "") if has_several else "",
        takes_actions=takes_actions(config, space, number),
    )
