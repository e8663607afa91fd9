"""Real sockets on loopback, and on interfaces of the test's own where it may make them."""

from __future__ import annotations

import asyncio
import errno
import fcntl
import os
import re
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Generator, Iterator
from contextlib import AsyncExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from tests import system
from ua_fleet.errors import TransportError
from ua_fleet.transport.addresses import parse_url
from ua_fleet.transport.base import Address
from ua_fleet.transport.interfaces import find_interface, list_interfaces
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.wire.actions import ActionMessage, ActionState, encode_action


class Listening:
    """A started transport and what it heard."""

    def __init__(self, transport: UdpTransport) -> None:
        self.transport = transport
        self.heard: list[bytes] = []
        self.senders: list[Address] = []

    def receive(self, datagram: bytes, sender: Address) -> None:
        self.heard.append(datagram)
        self.senders.append(sender)

    async def until(self, count: int) -> list[bytes]:
        """What was heard, once it is `count` datagrams."""
        async with asyncio.timeout(60):
            while len(self.heard) < count:
                await asyncio.sleep(0.005)
        return self.heard


Start = Callable[..., Awaitable[Listening]]


@pytest.fixture
async def start() -> AsyncIterator[Start]:
    """Starts transports and closes them when the test is over."""
    async with AsyncExitStack() as stack:

        async def started(url: str, interface: str = "lo", **options: Any) -> Listening:
            listening = Listening(UdpTransport(url, interface, **options))
            stack.push_async_callback(listening.transport.close)
            await listening.transport.start(listening.receive)
            return listening

        yield started


async def settle() -> None:
    """Let what is on its way over loopback arrive: it is in the socket's buffer when `send` returns."""
    for _ in range(5):
        await asyncio.sleep(0.01)


async def test_all_members_of_a_group_hear_a_datagram_the_sender_too(udp_url: str, start: Start) -> None:
    one, other = await start(udp_url), await start(udp_url, "127.0.0.1")
    one.transport.send(b"hello")
    assert await one.until(1) == [b"hello"]
    assert await other.until(1) == [b"hello"]
    assert one.senders[0][0] == "127.0.0.1"
    assert one.transport.stats.sent == one.transport.stats.received == 1


async def test_what_a_transport_sends_itself_can_be_kept_out_by_the_kernel(udp_url: str, start: Start) -> None:
    deaf, other = await start(udp_url, hears_itself=False), await start(udp_url)
    for number in range(20):
        deaf.transport.send(b"own %d" % number)
    other.transport.send(b"foreign")
    await other.until(21)
    assert await deaf.until(1) == [b"foreign"]
    other.transport.send(b"answer", other.senders[0])
    assert await deaf.until(2) == [b"foreign", b"answer"]
    await asyncio.sleep(1.1)  # until the kernel was asked for its drops
    assert (deaf.transport.stats.received, deaf.transport.stats.kernel_drops) == (2, 0)


async def test_a_transport_tells_its_own_messages_from_those_of_another_process(udp_url: str, start: Start) -> None:
    first, second = await start(udp_url), await start(udp_url)
    first.transport.send(b"first")
    second.transport.send(b"second")
    heard = await first.until(2)
    own = dict(zip(heard, map(first.transport.is_own, first.senders), strict=True))
    assert own == {b"first": True, b"second": False}


async def test_kernel_drops_are_counted_beside_a_transport_s_own_datagrams(udp_url: str, start: Start) -> None:
    deaf = await start(udp_url, hears_itself=False, receive_buffer_bytes=4096)
    other = await start(udp_url)
    for _ in range(500):  # without giving the event loop a chance to read
        other.transport.send(b"x" * 500)
        deaf.transport.send(b"own")
    async with asyncio.timeout(60):
        while deaf.transport.stats.kernel_drops == 0:
            await asyncio.sleep(0.05)
    assert deaf.transport.stats.kernel_drops + deaf.transport.stats.received == 500


async def test_an_action_is_taken_before_the_values_that_came_before_it(udp_url: str, start: Start) -> None:
    listening, sender = await start(udp_url), await start(udp_url)
    action = encode_action(
        ActionMessage(
            300, 2, 7, 1, 1, ActionState.EXECUTING, is_request=True, requestor_id="0.a", correlation_data=b"x"
        )
    )
    for number in range(20):
        sender.transport.send(b"value %d" % number)
    sender.transport.send(action)
    heard = await listening.until(21)
    assert heard == [action, *[b"value %d" % number for number in range(20)]]


async def test_what_is_urgent_is_taken_before_the_values_too(udp_url: str, start: Start) -> None:
    listening, sender = await start(udp_url, urgent_heads=(b"now", b"hey")), await start(udp_url)
    for number in range(20):
        sender.transport.send(b"value %d" % number)
    sender.transport.send(b"now or never")
    heard = await listening.until(21)
    assert heard == [b"now or never", *[b"value %d" % number for number in range(20)]]


async def test_others_have_their_turn_between_messages_that_take_long(udp_url: str, start: Start) -> None:
    """A description of 500 fields takes some milliseconds to read: a batch of them stopped the server for 0.3 s."""
    loop = asyncio.get_running_loop()
    turns: list[int] = []
    turn = 0

    def count() -> None:
        nonlocal turn
        turn += 1
        loop.call_soon(count)

    listening = await start(udp_url)
    sender = await start(udp_url)

    def receive(datagram: bytes, address: Address) -> None:
        listening.receive(datagram, address)
        turns.append(turn)
        time.sleep(0.006)

    await listening.transport.close()
    await listening.transport.start(receive)
    for number in range(20):
        sender.transport.send(bytes([number]))
    loop.call_soon(count)
    assert await listening.until(20) == [bytes([number]) for number in range(20)]
    assert len(set(turns)) == 20


async def test_another_group_on_the_same_port_is_not_heard(udp_url: str, start: Start) -> None:
    host, port = parse_url(udp_url)
    first, second, third, last = host.split(".")
    sibling = f"opc.udp://{first}.{second}.{third}.{int(last) % 254 + 1}:{port}"
    one, other = await start(udp_url), await start(sibling)
    one.transport.send(b"one")
    other.transport.send(b"other")
    await one.until(1)
    await other.until(1)
    await settle()
    assert (one.heard, other.heard) == ([b"one"], [b"other"])


async def test_multicast_stays_on_its_interface(udp_url: str, start: Start) -> None:
    beside = next((found for found in list_interfaces() if found.is_up and found.name != "lo"), None)
    if beside is None:
        pytest.skip("this machine has loopback only")
    on_loopback, on_other = await start(udp_url), await start(udp_url, beside.name)
    on_loopback.transport.send(b"lo")
    on_other.transport.send(b"other")
    await on_loopback.until(1)
    await on_other.until(1)
    await settle()
    assert (on_loopback.heard, on_other.heard) == ([b"lo"], [b"other"])


async def test_unicast_goes_to_the_host_and_comes_to_the_interface_s_address(start: Start) -> None:
    _, port = parse_url(system.free_multicast_url())
    one = await start(f"opc.udp://127.0.0.3:{port}", "127.0.0.2")
    other = await start(f"opc.udp://127.0.0.2:{port}", "127.0.0.3")
    one.transport.send(b"from one")
    other.transport.send(b"from other")
    assert await one.until(1) == [b"from other"]
    assert await other.until(1) == [b"from one"]
    assert one.senders[0][0] == "127.0.0.3"


async def test_a_unicast_peer_that_is_away_does_not_disturb(start: Start) -> None:
    """The kernel reports its ICMP answer at a later send; that datagram is sent again."""
    _, port = parse_url(system.free_multicast_url())
    one = await start(f"opc.udp://127.0.0.3:{port}", "127.0.0.2")
    for _ in range(5):
        one.transport.send(b"nobody there")
    other = await start(f"opc.udp://127.0.0.2:{port}", "127.0.0.3")
    one.transport.send(b"now")
    assert await other.until(1) == [b"now"]
    assert one.transport.stats.send_failed == 0


async def test_a_host_name_is_looked_up(start: Start) -> None:
    _, port = parse_url(system.free_multicast_url())
    one = await start(f"opc.udp://localhost:{port}")
    one.transport.send(b"to myself")
    assert await one.until(1) == [b"to myself"]
    with pytest.raises(TransportError, match="no IP address and no known host name"):
        await start(f"opc.udp://nobody.invalid:{port}")


async def test_a_unicast_address_in_use_is_told_with_the_remedy(start: Start) -> None:
    _, port = parse_url(system.free_multicast_url())
    await start(f"opc.udp://127.0.0.1:{port}")
    with pytest.raises(TransportError, match=rf"127\.0\.0\.1 port {port} is in use; .*choose another port"):
        await start(f"opc.udp://127.0.0.1:{port}")


async def test_a_multicast_port_that_is_not_shared_is_told(udp_url: str, start: Start) -> None:
    host, port = parse_url(udp_url)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as selfish:
        selfish.bind((host, port))
        with pytest.raises(TransportError, match="is in use"):
            await start(udp_url)


@pytest.mark.parametrize(
    ("interface", "expected"),
    [
        ("nope0", r"no network interface 'nope0'; there are .*lo \(127\.0\.0\.1\)"),
        ("203.0.113.77", r"no network interface has the address 203\.0\.113\.77; there are .*lo \(127\.0\.0\.1\)"),
    ],
)
async def test_an_interface_that_is_not_there_is_told_with_those_that_are(
    udp_url: str, start: Start, interface: str, expected: str
) -> None:
    with pytest.raises(TransportError, match=expected) as caught:
        await start(udp_url, interface)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (errno.ENETUNREACH, r"no multicast route to 239\..* through lo; add one: ip route add 224\.0\.0\.0/4 dev lo"),
        (errno.EPERM, "no permission to send to .* look at the firewall's rules"),
        (errno.EINVAL, "cannot send to .* through lo: Invalid argument"),
    ],
)
async def test_what_the_kernel_refuses_is_told_with_the_remedy(
    udp_url: str, start: Start, monkeypatch: pytest.MonkeyPatch, number: int, expected: str
) -> None:
    def refuse(self: socket.socket, address: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(socket.socket, "connect", refuse)
    with pytest.raises(TransportError, match=expected):
        await start(udp_url)


async def test_a_privileged_port_is_told_with_the_remedy(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: socket.socket, address: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(socket.socket, "bind", refuse)
    with pytest.raises(TransportError, match=r"no permission to listen on .* port 99; choose a port above 1023"):
        await start("opc.udp://127.0.0.1:99")


async def test_an_answer_reaches_the_sender_alone_at_the_port_it_sent_from(udp_url: str, start: Start) -> None:
    one, other, third = await start(udp_url), await start(udp_url), await start(udp_url)
    one.transport.send(b"request")
    await other.until(1)
    other.transport.send(b"response", other.senders[0])
    assert await one.until(2) == [b"request", b"response"]
    await settle()
    assert (other.heard, third.heard) == ([b"request"], [b"request"])
    other.transport.send(b"to all")
    await one.until(3)
    assert one.senders[1] == one.senders[2], "to all and to one go from the same port"


async def test_an_answer_reaches_a_unicast_sender(start: Start) -> None:
    _, port = parse_url(system.free_multicast_url())
    one = await start(f"opc.udp://127.0.0.3:{port}", "127.0.0.2")
    other = await start(f"opc.udp://127.0.0.2:{port}", "127.0.0.3")
    one.transport.send(b"request")
    await other.until(1)
    other.transport.send(b"response", other.senders[0])
    assert await one.until(1) == [b"response"]
    assert one.senders[0][0] == "127.0.0.3"


async def test_no_other_socket_can_come_to_the_port_that_answers_reach(udp_url: str, start: Start) -> None:
    one = await start(udp_url)
    one.transport.send(b"x")
    await one.until(1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
        thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        with pytest.raises(OSError, match="in use"):
            thief.bind(one.senders[0])


async def test_an_address_that_takes_nothing_is_counted_and_disturbs_nobody(udp_url: str, start: Start) -> None:
    one = await start(udp_url)
    one.transport.send(b"x", ("255.255.255.255", 4840))
    one.transport.send(b"x" * 65_508, ("127.0.0.1", 4840))
    for _ in range(3):
        one.transport.send(b"nobody there", ("127.0.0.1", 9))
    one.transport.send(b"to all")
    assert await one.until(1) == [b"to all"]
    assert (one.transport.stats.sent, one.transport.stats.send_failed) == (4, 2)


async def test_kernel_drops_are_counted(udp_url: str, start: Start) -> None:
    listening = await start(udp_url, receive_buffer_bytes=4096)
    with capture_logs() as logs:
        for _ in range(500):  # without giving the event loop a chance to read
            listening.transport.send(b"x" * 500)
        async with asyncio.timeout(60):
            while listening.transport.stats.kernel_drops == 0:
                await asyncio.sleep(0.05)
    stats = listening.transport.stats
    assert stats.sent == 500
    assert stats.kernel_drops + stats.received == 500
    assert [log["dropped"] for log in logs] == [stats.kernel_drops]


async def test_a_large_burst_fits_a_large_buffer(udp_url: str, start: Start) -> None:
    listening = await start(udp_url)
    burst = min(2000, listening.transport.stats.receive_buffer_bytes // 1500)
    for number in range(burst):
        listening.transport.send(struct.pack("<H", number) * 40)
    heard = await listening.until(burst)
    assert [struct.unpack_from("<H", datagram)[0] for datagram in heard] == list(range(burst))


async def test_the_event_loop_gets_on_while_datagrams_keep_coming(udp_url: str, start: Start) -> None:
    listening = await start(udp_url)
    turns: list[int] = []
    loop = asyncio.get_running_loop()
    for _ in range(300):
        listening.transport.send(b"x")

    def turn() -> None:
        turns.append(len(listening.heard))
        if len(listening.heard) < 300:
            loop.call_soon(turn)

    loop.call_soon(turn)
    await listening.until(300)
    assert len(set(turns)) >= 300 // 64, "other callbacks run between batches"


async def test_a_small_buffer_is_said_with_the_remedy(udp_url: str, start: Start) -> None:
    with capture_logs() as logs:
        listening = await start(udp_url, receive_buffer_bytes=1 << 30)
    granted = listening.transport.stats.receive_buffer_bytes
    opened = next(log for log in logs if log["event"] == "pubsub transport open")
    assert opened["receive_buffer_bytes"] == granted > 0
    warned = [log for log in logs if log["event"] == "receive buffer smaller than wanted"]
    assert bool(warned) == (granted < 1 << 30)
    assert all("net.core.rmem_max" in log["remedy"] for log in warned)


async def test_a_datagram_that_is_too_large_is_counted(udp_url: str, start: Start) -> None:
    listening = await start(udp_url)
    listening.transport.send(b"x" * 65_508)
    listening.transport.send(b"x" * 65_507)
    assert [len(datagram) for datagram in await listening.until(1)] == [65_507]
    assert (listening.transport.stats.sent, listening.transport.stats.send_failed) == (1, 1)


async def test_closing_twice_and_in_the_middle_of_a_batch_is_safe(udp_url: str) -> None:
    transport = UdpTransport(udp_url, "lo")
    heard: list[bytes] = []
    closing: list[asyncio.Future[None]] = []

    def receive(datagram: bytes, _: Address) -> None:
        heard.append(datagram)
        closing.append(asyncio.ensure_future(transport.close()))

    await transport.start(receive)
    transport.send(b"a")
    async with asyncio.timeout(60):
        while not closing:
            await asyncio.sleep(0.005)
    await asyncio.gather(*closing)
    await transport.close()
    transport.send(b"b")
    assert transport.stats.send_failed == 1


async def test_a_failed_start_leaves_nothing_open(udp_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = set(os.listdir("/proc/self/fd"))
    with pytest.raises(TransportError):
        await UdpTransport(udp_url, "nope0").start(lambda _, __: None)
    assert set(os.listdir("/proc/self/fd")) == before


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


@contextmanager
def alone() -> Generator[None]:
    """Wait until no other process has a cable: tests look for interfaces by their addresses, which all cables share."""
    with (Path(tempfile.gettempdir()) / f"ua_fleet-cable-{os.getuid()}").open("w") as one:
        fcntl.flock(one, fcntl.LOCK_EX)
        yield


@pytest.fixture
def cable() -> Iterator[str]:
    """One end of a virtual cable of this test's own, named after its process."""
    name = f"uaf{os.getpid() % 1_000_000}"
    with alone():
        for _, other in socket.if_nameindex():  # of tests that were killed
            if (dead := re.fullmatch(r"uaf(\d+)", other)) and not Path(f"/proc/{dead[1]}").exists():
                subprocess.run(["ip", "link", "del", other], check=False, capture_output=True)
        try:
            ip("link", "add", name, "type", "veth", "peer", "name", f"{name}p")
        except (OSError, subprocess.CalledProcessError) as error:
            pytest.skip(f"cannot make a network interface: {error}")
        try:
            bring_up(name, "198.18.7.1")
            yield name
        finally:
            subprocess.run(["ip", "link", "del", name], check=False, capture_output=True)


def bring_up(name: str, address: str) -> None:
    ip("addr", "add", f"{address}/24", "dev", name)
    for end in (name, f"{name}p"):
        ip("link", "set", end, "up")


async def heard_again(listening: Listening, marker: bytes) -> Address:
    """Send until it is heard; the sender's address then."""
    async with asyncio.timeout(60):
        while marker not in listening.heard:
            listening.transport.send(marker)
            await asyncio.sleep(0.05)
    return listening.senders[listening.heard.index(marker)]


async def test_an_interface_that_goes_and_comes_back_is_followed(udp_url: str, start: Start, cable: str) -> None:
    listening = await start(udp_url, cable)
    assert (await heard_again(listening, b"first"))[0] == "198.18.7.1"
    with capture_logs() as logs:
        ip("link", "del", cable)
        async with asyncio.timeout(60):
            while not logs:
                listening.transport.send(b"into the void")
                await asyncio.sleep(0.05)
        ip("link", "add", cable, "type", "veth", "peer", "name", f"{cable}p")
        bring_up(cable, "198.18.7.9")
        assert (await heard_again(listening, b"again"))[0] == "198.18.7.9"
    assert [log["event"] for log in logs] == ["pubsub interface lost", "pubsub interface back"]
    assert listening.transport.stats.send_failed > 0


async def test_a_new_address_of_the_interface_is_followed(udp_url: str, start: Start, cable: str) -> None:
    listening = await start(udp_url, cable)
    ip("addr", "del", "198.18.7.1/24", "dev", cable)
    ip("addr", "add", "198.18.7.20/24", "dev", cable)
    async with asyncio.timeout(60):
        while "198.18.7.20" not in {host for host, _ in listening.senders}:
            listening.transport.send(b"x")
            await asyncio.sleep(0.05)


async def test_a_unicast_listener_follows_its_interface_s_address(start: Start, cable: str) -> None:
    _, port = parse_url(system.free_multicast_url())
    listening = await start(f"opc.udp://198.18.7.1:{port}", cable)
    ip("addr", "del", "198.18.7.1/24", "dev", cable)
    ip("addr", "add", "198.18.7.20/24", "dev", cable)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        async with asyncio.timeout(60):
            while b"x" not in listening.heard:
                sender.sendto(b"x", ("198.18.7.20", port))
                await asyncio.sleep(0.05)


async def test_an_interface_that_is_down_is_told_with_the_remedy(udp_url: str, start: Start, cable: str) -> None:
    ip("link", "set", cable, "down")
    with pytest.raises(TransportError, match=f"interface {cable} is down; bring it up: ip link set {cable} up"):
        await start(udp_url, cable)


def test_interfaces_are_found_by_name_and_by_each_address(cable: str) -> None:
    ip("addr", "add", "198.18.8.5/24", "dev", cable)
    by_name, by_second = find_interface(cable), find_interface("198.18.8.5")
    assert (by_name.name, by_name.address, by_name.is_up) == (cable, "198.18.7.1", True)
    assert (by_second.name, by_second.index, by_second.address) == (cable, by_name.index, "198.18.8.5")


def test_an_interface_is_found_by_a_subnet(cable: str) -> None:
    ip("addr", "add", "198.18.8.5/24", "dev", cable)
    assert (find_interface("198.18.7.0/26").name, find_interface("198.18.7.0/26").address) == (cable, "198.18.7.1")
    assert (find_interface("198.18.8.0/24").name, find_interface("198.18.8.0/24").address) == (cable, "198.18.8.5")


def test_a_subnet_without_an_interface_is_told_with_what_is_there(cable: str) -> None:
    there = rf"no network interface has an address in 198\.18\.9\.0/24; there are .*{cable} \(198\.18\.7\.1\)"
    with pytest.raises(TransportError, match=there):
        find_interface("198.18.9.0/24")


@pytest.mark.parametrize("broken", ["198.18.7.0/33", "198.18.7.1/24", "eth0/24"])
def test_a_broken_subnet_is_told(broken: str) -> None:
    with pytest.raises(TransportError, match=f"'{broken}' is no subnet such as 192.168.1.0/24: "):
        find_interface(broken)


async def test_an_interface_named_by_its_subnet_is_followed(udp_url: str, start: Start, cable: str) -> None:
    listening = await start(udp_url, "198.18.7.0/24")
    ip("addr", "del", "198.18.7.1/24", "dev", cable)
    ip("addr", "add", "198.18.7.20/24", "dev", cable)
    async with asyncio.timeout(60):
        while not any(host == "198.18.7.20" for host, _ in listening.senders):
            listening.transport.send(b"x")
            await asyncio.sleep(0.05)


def test_an_interface_without_an_address_is_told_with_the_remedy(cable: str) -> None:
    ip("addr", "flush", "dev", cable)
    with pytest.raises(TransportError, match=f"interface {cable} has no IPv4 address: give it one"):
        find_interface(cable)


def test_every_address_of_loopback_is_found() -> None:
    assert find_interface("127.0.0.5").name == "lo"
    assert find_interface("127.0.0.5").address == "127.0.0.5"
