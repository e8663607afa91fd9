"""A server on an IPv6 address says where it is as a client can use it: in brackets (RFC 3986 3.2.2)."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from asyncua.client.client import Client

from tests.integration.server_security.harness import CHEAP, SERVER_URI, Identities
from ua_fleet.config.schema import ServerConfig
from ua_fleet.endpoint.hardened_server import create_server
from ua_fleet.endpoint.users import UserStore

pytestmark = pytest.mark.asyncio(loop_scope="module")


def _has_ipv6() -> bool:
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        return False
    return True


@pytest.mark.skipif(not _has_ipv6(), reason="this machine has no IPv6")
async def test_the_endpoints_of_an_ipv6_address_can_be_used(tmp_path: Path, identities: Identities) -> None:
    identities.install_server(tmp_path)
    users = UserStore(tmp_path / "users.yaml", CHEAP)
    server = await create_server(ServerConfig(host="::1", port=0), tmp_path, application_uri=SERVER_URI, users=users)
    async with server:
        url = f"opc.tcp://[::1]:{server.port}/ua_fleet"
        assert server.endpoint.geturl() == url
        found = await Client(url).connect_and_get_server_endpoints()
        assert {endpoint.EndpointUrl for endpoint in found} == {url}
