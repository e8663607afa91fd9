"""What differs between IPv4 and IPv6 for a UDP socket: its addresses, how it joins a group and how it sends to one.

An address is (host, port) for both. The host of an IPv6 address that counts on one link alone has its interface behind
it, `fe80::1%3`, so that an answer goes out there.
"""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import struct
from typing import Any, Final

from ua_fleet.errors import TransportError
from ua_fleet.transport.base import Address
from ua_fleet.transport.interfaces import Interface

__all__ = ["IPV4", "IPV6", "Family", "family_of"]

# Linux's numbers, which Python has no names for.
_IP_MULTICAST_ALL: Final = 49
_IPV6_MULTICAST_ALL: Final = 29


class Family:
    """IPv4; what is different in IPv6 is overridden there."""

    version = 4
    kind = socket.AF_INET
    more_groups = "sysctl net.ipv4.igmp_max_memberships=100"
    """Lets a socket join more groups."""

    def new_route(self, host: str | None, interface: str) -> str:
        """The command that gives a route to a host, or to all groups, through an interface."""
        return f"ip route add {host or '224.0.0.0/4'} dev {interface}"

    def open(self) -> socket.socket:
        """A UDP socket that does not block."""
        return socket.socket(self.kind, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)

    def sockaddr(self, host: str, port: int, interface: Interface) -> Any:
        """What the socket module takes for an address on an interface."""
        del interface
        return (host, port)

    def address(self, sockaddr: Any) -> Address:
        """The address that the socket module gives."""
        return sockaddr  # type: ignore[no-any-return]

    def target(self, address: Address) -> Any:
        """What the socket module takes for an address that it gave."""
        return address

    def only_joined(self, receiver: socket.socket) -> None:
        """Only what this socket joined, on the interface where it joined it."""
        receiver.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)

    def join(self, receiver: socket.socket, group: str, index: int) -> None:
        """Be a member of a group on an interface."""
        membership = _ip_mreqn(group=socket.inet_aton(group), index=index)
        receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)

    def leave(self, receiver: socket.socket, group: str, index: int) -> None:
        """Be a member no more, where the kernel has not taken that away with the interface."""
        membership = _ip_mreqn(group=socket.inet_aton(group), index=index)
        with contextlib.suppress(OSError):
            receiver.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, membership)

    def send_through(self, sender: socket.socket, interface: Interface, hops: int) -> None:
        """Send to groups through this interface, over so many routers, and to members on this machine."""
        option = _ip_mreqn(address=socket.inet_aton(interface.address), index=interface.index)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, option)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, hops)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)


class _Ipv6(Family):
    version = 6
    kind = socket.AF_INET6
    more_groups = "sysctl net.core.optmem_max=262144"

    def new_route(self, host: str | None, interface: str) -> str:
        if host is None and interface == "lo":  # only as a local one does what is sent come back
            return "ip -6 route add local ff00::/8 dev lo table local"
        return f"ip -6 route add {host or 'ff00::/8'} dev {interface}"

    def open(self) -> socket.socket:
        opened = super().open()
        try:
            opened.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        except OSError:
            opened.close()
            raise
        return opened

    def sockaddr(self, host: str, port: int, interface: Interface) -> Any:
        return (host.partition("%")[0], port, 0, interface.index if _is_of_link(host) else 0)

    def address(self, sockaddr: Any) -> Address:
        host, port, _, scope = sockaddr
        return (f"{host}%{scope}" if scope else host, port)

    def target(self, address: Address) -> Any:
        host, _, scope = address[0].partition("%")
        return (host, address[1], 0, int(scope or 0))

    def only_joined(self, receiver: socket.socket) -> None:
        receiver.setsockopt(socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)

    def join(self, receiver: socket.socket, group: str, index: int) -> None:
        receiver.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, _ipv6_mreq(group, index))

    def leave(self, receiver: socket.socket, group: str, index: int) -> None:
        with contextlib.suppress(OSError):
            receiver.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_LEAVE_GROUP, _ipv6_mreq(group, index))

    def send_through(self, sender: socket.socket, interface: Interface, hops: int) -> None:
        sender.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, interface.index)
        sender.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, hops)
        sender.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_LOOP, 1)


IPV4: Final = Family()
IPV6: Final = _Ipv6()


def family_of(host: str) -> Family:
    """The family of a literal address; raises TransportError for none."""
    try:
        return IPV4 if ipaddress.ip_address(host).version == 4 else IPV6
    except ValueError:
        raise TransportError(f"{host!r} is no IP address") from None


def _is_of_link(host: str) -> bool:
    """Whether an IPv6 address counts on one link, or on this machine's interface, alone: which one has to be said."""
    packed = ipaddress.IPv6Address(host).packed
    if packed[0] == 0xFF:
        return packed[1] & 0x0F in (1, 2)
    return packed[0] == 0xFE and packed[1] & 0xC0 == 0x80


def _ip_mreqn(*, group: bytes = b"", address: bytes = b"", index: int) -> bytes:
    """A `struct ip_mreqn` (man 7 ip)."""
    return struct.pack("4s4si", group, address, index)


def _ipv6_mreq(group: str, index: int) -> bytes:
    """A `struct ipv6_mreq` (man 7 ipv6)."""
    return struct.pack("16sI", socket.inet_pton(socket.AF_INET6, group.partition("%")[0]), index)
