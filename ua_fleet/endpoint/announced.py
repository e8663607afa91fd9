"""The server's Endpoints as PubSub announces them (OPC 10000-14 7.2.4.6.6)."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import ipaddress
import socket

from asyncua import ua
from asyncua.server.server import Server
from asyncua.ua.ua_binary import struct_to_binary

from ua_fleet.wire.configuration import ENDPOINT_DESCRIPTION
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.discovered import EndpointDescription

__all__ = ["announced_endpoints"]


async def announced_endpoints(server: Server) -> tuple[EndpointDescription, ...]:
    """What GetEndpoints answers. A server that listens on every address is named by its host's name."""
    host = server.endpoint.hostname or ""
    name = (socket.gethostname(), server.endpoint.port or 0) if _is_everywhere(host) else None
    found = await server.iserver.get_endpoints(ua.GetEndpointsParameters(), sockname=name)
    return tuple([ENDPOINT_DESCRIPTION.decode(Cursor(struct_to_binary(endpoint))) for endpoint in found])


def _is_everywhere(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return False
