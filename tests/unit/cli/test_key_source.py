"""Where bridges ask for their keys, by the server's address."""

from __future__ import annotations

import pytest

from tests.unit.cli.conftest import FLEET
from ua_fleet.cli.key_source import service_endpoint
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import ConfigInvalid


def fleet(host: str) -> FleetConfig:
    return load_content(f"{FLEET}server: {{host: '{host}'}}\n".encode(), "fleet.yaml", {})


@pytest.mark.parametrize(
    ("host", "asked"),
    [
        ("127.0.0.1", "127.0.0.1"),
        ("0.0.0.0", "127.0.0.1"),
        ("::", "[::1]"),
        ("::1", "[::1]"),
        ("fd00::7", "[fd00::7]"),
        ("hall", "hall"),
    ],
)
def test_bridges_ask_where_the_server_listens(host: str, asked: str) -> None:
    assert service_endpoint(fleet(host)) == f"opc.tcp://{asked}:4840/ua_fleet"


@pytest.mark.parametrize("host", ["", "[::1]"])
def test_a_host_that_cannot_be_announced_is_refused(host: str) -> None:
    with pytest.raises(ConfigInvalid, match="an IPv6 address without brackets"):
        fleet(host)
