from __future__ import annotations

import pytest

from ua_fleet.errors import TransportError
from ua_fleet.transport.addresses import parse_url
from ua_fleet.transport.base import Transport
from ua_fleet.transport.udp import UdpTransport


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("opc.udp://224.0.2.14:4840", ("224.0.2.14", 4840)),
        ("opc.udp://192.168.1.7:4840/", ("192.168.1.7", 4840)),
        ("opc.udp://robot.local:14840", ("robot.local", 14840)),
        ("opc.udp://[ff15::ea7]:4840", ("ff15::ea7", 4840)),
    ],
)
def test_host_and_port(url: str, expected: tuple[str, int]) -> None:
    assert parse_url(url) == expected


@pytest.mark.parametrize(
    "url",
    [
        "",
        "opc.tcp://a:1",
        "opc.udp://a",
        "opc.udp://:4840",
        "opc.udp://a:0",
        "opc.udp://a:65536",
        "opc.udp://a:x",
        "opc.udp://ff15::ea7:4840",
        "opc.udp://[224.0.2.14]:4840",
        "opc.udp://[]:4840",
        "a:1",
    ],
)
def test_what_is_no_address_is_refused_with_an_example(url: str) -> None:
    with pytest.raises(TransportError, match=r"write opc\.udp://<host>:<port>") as caught:
        parse_url(url)
    assert "\n" not in str(caught.value)


def test_a_udp_transport_is_a_transport_and_opens_nothing_by_itself() -> None:
    transport: Transport = UdpTransport("opc.udp://239.1.2.3:4840", "lo")
    transport.send(b"before start")
    assert transport.stats.send_failed == 1
