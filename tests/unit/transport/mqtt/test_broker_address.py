"""Addresses of brokers."""

from __future__ import annotations

import pytest

from ua_fleet.errors import TransportError
from ua_fleet.transport.mqtt.address import is_broker_url, parse_broker_url


@pytest.mark.parametrize(
    ("url", "host", "port", "has_tls"),
    [
        ("mqtt://127.0.0.1:1884", "127.0.0.1", 1884, False),
        ("mqtt://broker", "broker", 1883, False),
        ("mqtts://broker.hall2/", "broker.hall2", 8883, True),
        ("mqtts://[::1]:9000", "::1", 9000, True),
        ("mqtt://[fe80::1]", "fe80::1", 1883, False),
    ],
)
def test_a_broker_has_a_host_and_a_port(url: str, host: str, port: int, has_tls: bool) -> None:
    assert is_broker_url(url)
    assert parse_broker_url(url) == (host, port, has_tls)


@pytest.mark.parametrize(
    "url",
    [
        "opc.udp://224.0.2.14:4840",
        "mqtt:broker",
        "mqtt://",
        "mqtt://:1883",
        "mqtt://broker:",
        "mqtt://broker:0",
        "mqtt://broker:65536",
        "mqtt://broker:1883/path",
        "mqtt://::1",
        "mqtt://[::1",
        "mqtt://[::1]1883",
    ],
)
def test_what_is_no_broker_says_so_in_one_line(url: str) -> None:
    with pytest.raises(TransportError) as raised:
        parse_broker_url(url)
    assert "\n" not in str(raised.value)


def test_a_password_in_a_url_is_not_taken_and_not_shown() -> None:
    with pytest.raises(TransportError) as raised:
        parse_broker_url("mqtts://robot:geheim@broker:8883")
    assert "geheim" not in str(raised.value)
    assert "password_file" in str(raised.value)
