"""UDP over IPv6 on a cable of the test's own: groups, single addresses, what a sender does not hear of itself."""

from __future__ import annotations

import asyncio
import ipaddress
import secrets
import subprocess

import pytest

from tests import system
from tests.integration.transport.test_udp import Start, cable, ip, settle, start
from ua_fleet.errors import TransportError
from ua_fleet.transport.addresses import parse_url
from ua_fleet.transport.interfaces import Interface, find_interface, list_interfaces
from ua_fleet.transport.udp import UdpTransport

__all__ = ["cable", "start"]

OWN = "fd55::77"
pytestmark = pytest.mark.skipif(
    not any(each.address == "::1" for each in list_interfaces(6)), reason="this machine has no IPv6"
)


@pytest.fixture
def wire(cable: str) -> str:
    """The cable with an address of the link and one of the site."""
    for address in ("fe80::77", OWN):
        ip("-6", "addr", "add", f"{address}/64", "dev", cable, "nodad")
    return cable


def free_group(scope: int = 5) -> str:
    """A multicast address that nobody else has: of a link (2) or of the site (5)."""
    _, port = parse_url(system.free_multicast_url())
    return f"opc.udp://[ff1{scope}::{secrets.randbelow(0xFFFF) + 1:x}:{secrets.randbelow(0xFFFF) + 1:x}]:{port}"


@pytest.mark.parametrize("scope", [2, 5])
async def test_all_members_of_a_group_hear_a_datagram_and_can_answer_its_sender(
    scope: int, start: Start, wire: str
) -> None:
    url = free_group(scope)
    one, other = await start(url, wire), await start(url, wire)
    one.transport.send(b"hello")
    assert await one.until(1) == [b"hello"]
    assert await other.until(1) == [b"hello"]
    host = other.senders[0][0]
    if scope == 2:
        assert ipaddress.IPv6Address(host).is_link_local
        assert host.partition("%")[2] == str(find_interface(wire, 6).index), "an answer knows its link"
    else:
        assert host == OWN
    assert [one.transport.is_own(one.senders[0]), other.transport.is_own(other.senders[0])] == [True, False]
    other.transport.send(b"answer", other.senders[0])
    assert (await one.until(2))[1] == b"answer"
    assert one.transport.stats.problem == ""


async def test_a_group_hears_nothing_of_another_group_at_the_same_port(start: Start, wire: str) -> None:
    url = free_group()
    _, port = parse_url(url)
    another = f"opc.udp://[ff15::dead:{secrets.randbelow(0xFFFF) + 1:x}]:{port}"
    one, other = await start(url, wire), await start(another, wire)
    other.transport.send(b"not for one")
    await other.until(1)
    await settle()
    assert one.heard == []


async def test_what_a_transport_sends_itself_is_kept_out_by_the_kernel(start: Start, wire: str) -> None:
    url = free_group()
    deaf, other = await start(url, wire, hears_itself=False), await start(url, wire)
    for number in range(20):
        deaf.transport.send(b"own %d" % number)
    other.transport.send(b"foreign")
    await other.until(21)
    assert await deaf.until(1) == [b"foreign"]
    other.transport.send(b"answer", other.senders[0])
    assert await deaf.until(2) == [b"foreign", b"answer"]
    await asyncio.sleep(1.1)  # until the kernel was asked for its drops
    assert (deaf.transport.stats.received, deaf.transport.stats.kernel_drops) == (2, 0)


async def test_unicast(start: Start) -> None:
    _, port = parse_url(free_group())
    listening = await start(f"opc.udp://[::1]:{port}")
    listening.transport.send(b"to itself")
    assert await listening.until(1) == [b"to itself"]


async def test_an_address_that_is_sent_to_may_be_none(wire: str) -> None:
    """What somebody wrote into a message is no reason to fail."""
    transport = UdpTransport(free_group(), wire)
    await transport.start(lambda _datagram, _sender: None)
    try:
        for host in ("fe80::1%many", "fe80::1%-1", "fe80::1%99999999999", "192.0.2.1", "::1%"):
            transport.send(b"x", (host, 4840))
        assert transport.stats.send_failed >= 4
    finally:
        await transport.close()


async def test_loopback_needs_a_route_for_groups() -> None:
    if (
        "ff00::/8"
        in subprocess.run(
            ["ip", "-6", "route", "show", "table", "local", "dev", "lo"], capture_output=True, text=True, check=True
        ).stdout
    ):
        pytest.skip("loopback has one here")
    route = "add one: ip -6 route add local ff00::/8 dev lo table local"
    with pytest.raises(TransportError, match=route):
        await UdpTransport(free_group(), "lo").start(lambda _datagram, _sender: None)


async def test_a_new_address_is_followed(start: Start, wire: str) -> None:
    listening = await start(free_group(), wire)
    ip("-6", "addr", "del", f"{OWN}/64", "dev", wire)
    ip("-6", "addr", "add", "fd55::99/64", "dev", wire, "nodad")
    async with asyncio.timeout(60):
        while "fd55::99" not in {host for host, _ in listening.senders}:
            listening.transport.send(b"x")
            await asyncio.sleep(0.05)


@pytest.mark.parametrize(
    ("interface", "text"),
    [
        ("127.0.0.1", "127.0.0.1 is an IPv4 address, and ff15::1 an IPv6 address; there are "),
        ("fd00:ffff::/32", "no network interface has an address in fd00:ffff::/32; there are "),
        ("nic9", "there is no network interface 'nic9'; there are "),
    ],
)
async def test_an_interface_that_is_not_there(interface: str, text: str) -> None:
    with pytest.raises(TransportError, match=text.replace(".", r"\.")):
        await UdpTransport("opc.udp://[ff15::1]:4840", interface).start(lambda _datagram, _sender: None)


def test_of_several_addresses_the_one_from_which_the_group_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    addresses = [
        Interface("eth9", 9, "fe80::9", True),
        Interface("eth9", 9, "fd00::9", True),
        Interface("eth9", 9, "fd00::10", True),
    ]
    monkeypatch.setattr("ua_fleet.transport.interfaces.list_interfaces", lambda _version=4: list(addresses))
    assert find_interface("eth9", 6, "ff12::1").address == "fe80::9"
    assert find_interface("eth9", 6, "ff15::1").address == "fd00::9"
    assert find_interface("eth9", 6, "fd00::77").address == "fd00::9"
    assert find_interface("fe80::/10", 6, "ff12::1").address == "fe80::9"
    assert find_interface("fd00::10", 6, "ff15::1").address == "fd00::10"
    del addresses[1:]
    assert find_interface("eth9", 6, "ff15::1").address == "fe80::9"
