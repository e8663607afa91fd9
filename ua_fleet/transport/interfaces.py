"""Network interfaces by name, address or subnet."""

from __future__ import annotations

import array
import contextlib
import fcntl
import ipaddress
import socket
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ua_fleet.errors import TransportError

__all__ = ["Interface", "find_interface", "interface_state", "list_interfaces", "machine_addresses"]

_SIOCGIFCONF: Final = 0x8912
_SIOCGIFFLAGS: Final = 0x8913
_IFF_UP: Final = 0x1
_DUPLICATE: Final = 0x08
_TENTATIVE: Final = 0x40
"""Flags of an IPv6 address that is not this machine's, or not yet (linux/if_addr.h)."""
_REQUEST_BYTES: Final = 40
"""Size of `struct ifreq` on 64-bit machines."""
_INET6: Final = Path("/proc/net/if_inet6")
_MOST_ADDRESSES: Final = 256
_LINK_SCOPE: Final = 2
"""Scope of a multicast address that no router passes on (RFC 4291 2.7); 1 is this machine."""
_LOOPBACK: Final = ipaddress.IPv4Network("127.0.0.0/8")


@dataclass(frozen=True, slots=True)
class Interface:
    """An interface as it is now. While it stays equal, sockets made for it stay good."""

    name: str
    index: int
    address: str
    """One of its addresses: the one asked for, the first in the subnet asked for, or the first that fits."""
    is_up: bool


def list_interfaces(version: int = 4) -> list[Interface]:
    """All addresses of this machine of an IP version, with their interfaces."""
    return _list_ipv4() if version == 4 else _list_ipv6()


def _list_ipv6() -> list[Interface]:
    """As the kernel tells them (proc_net_if_inet6), without those that it may still find to be another machine's."""
    interfaces: list[Interface] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        for line in _INET6.read_text(encoding="ascii").splitlines():
            digits, index, _, _, flags, name = line.split()
            if int(flags, 16) & (_TENTATIVE | _DUPLICATE):
                continue
            with contextlib.suppress(OSError):  # it went meanwhile
                address = str(ipaddress.IPv6Address(int(digits, 16)))
                interfaces.append(Interface(name, int(index, 16), address, _is_up(probe, name)))
    return interfaces


def _is_up(probe: socket.socket, name: str) -> bool:
    request = struct.pack(f"{_REQUEST_BYTES}s", name.encode())
    flags: int = struct.unpack_from("H", fcntl.ioctl(probe, _SIOCGIFFLAGS, request), 16)[0]
    return bool(flags & _IFF_UP)


def _list_ipv4() -> list[Interface]:
    buffer = array.array("B", bytes(_REQUEST_BYTES * _MOST_ADDRESSES))
    start, size = buffer.buffer_info()
    interfaces: list[Interface] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        answer = fcntl.ioctl(probe, _SIOCGIFCONF, struct.pack("iL", size, start))
        used: int = struct.unpack_from("i", answer)[0]
        for offset in range(0, used, _REQUEST_BYTES):
            request = buffer[offset : offset + _REQUEST_BYTES].tobytes()
            name = request[:16].split(b"\0", 1)[0].split(b":", 1)[0].decode()
            with contextlib.suppress(OSError):  # it went meanwhile
                address = socket.inet_ntoa(request[20:24])
                interfaces.append(Interface(name, socket.if_nametoindex(name), address, _is_up(probe, name)))
    return interfaces


def interface_state(probe: socket.socket, interface: Interface) -> bytes:
    """What has to change before `find_interface` finds another interface in place of this one; of any socket.

    Four calls of the kernel, and nothing is read of their answers: a tenth of what it takes to look.
    """
    name = interface.name
    if ":" in interface.address:
        try:
            return bytes((_is_up(probe, name),)) + _INET6.read_bytes()
        except OSError:
            return b""
    buffer = array.array("B", bytes(_REQUEST_BYTES * _MOST_ADDRESSES))
    start, size = buffer.buffer_info()
    try:
        answer = fcntl.ioctl(probe, _SIOCGIFCONF, struct.pack("iL", size, start))
        flags = fcntl.ioctl(probe, _SIOCGIFFLAGS, struct.pack(f"{_REQUEST_BYTES}s", name.encode()))
        index = socket.if_nametoindex(name)
    except OSError:  # it is gone
        return b""
    used: int = struct.unpack_from("i", answer)[0]
    return struct.pack("iH", index, struct.unpack_from("H", flags, 16)[0]) + buffer[:used].tobytes()


def machine_addresses() -> list[str]:
    """All addresses at which other machines may reach this one, IPv4 first; without those of one link alone."""
    found = [each.address for version in (4, 6) for each in list_interfaces(version) if each.is_up]
    addresses = [ipaddress.ip_address(address) for address in dict.fromkeys(found)]
    return [str(address) for address in addresses if not (address.is_loopback or address.is_link_local)]


def find_interface(wanted: str, version: int = 4, to: str = "") -> Interface:
    """The interface with this name or address, or with an address in this subnet (`192.168.1.0/24`).

    A subnet is for machines that get their address and the order of their interfaces from others: with DHCP, and in
    containers. Where several addresses are in it, it is the first one. Of several IPv6 addresses of an interface, the
    first one from which `to` can be reached.

    Raises:
        TransportError: there is none, or it has no address of this IP version; names those that are there.
    """
    interfaces = list_interfaces(version)
    if version == 6:
        interfaces.sort(key=lambda each: _reaches(each.address, to), reverse=True)
    if "/" in wanted:  # which the kernel allows in no interface's name
        return _find_in_subnet(wanted, interfaces, version)
    for interface in interfaces:
        if wanted in (interface.name, interface.address):
            return interface
    there = _what_is_there(interfaces, version)
    try:
        address = ipaddress.ip_address(wanted)
    except ValueError:
        if any(name == wanted for _, name in socket.if_nameindex()):
            remedy = f"give it one (ip addr add <address> dev {wanted})"
            raise TransportError(f"network interface {wanted} has no IPv{version} address: {remedy}; {there}") from None
        raise TransportError(f"there is no network interface {wanted!r}; {there}") from None
    if address.version != version:
        raise TransportError(f"{wanted} is an IPv{address.version} address, and {to} an IPv{version} address; {there}")
    if address in _LOOPBACK:  # all of 127/8 is ours without being listed
        for interface in interfaces:
            if interface.address.startswith("127."):
                return Interface(interface.name, interface.index, wanted, interface.is_up)
    raise TransportError(f"no network interface has the address {wanted}; {there}")


def _reaches(own: str, to: str) -> bool:
    """Whether messages to an IPv6 address go out from an own one: both for one link alone, or neither."""
    address, target = ipaddress.IPv6Address(own), ipaddress.IPv6Address(to or "::1")
    of_link = target.is_link_local or (target.is_multicast and target.packed[1] & 0x0F <= _LINK_SCOPE)
    return address.is_link_local is of_link


def _find_in_subnet(wanted: str, interfaces: list[Interface], version: int) -> Interface:
    try:
        subnet = ipaddress.ip_network(wanted)
    except ValueError as error:
        raise TransportError(f"{wanted!r} is no subnet such as 192.168.1.0/24: {error}") from None
    for interface in interfaces:
        if ipaddress.ip_address(interface.address) in subnet:
            return interface
    raise TransportError(f"no network interface has an address in {subnet}; {_what_is_there(interfaces, version)}")


def _what_is_there(interfaces: list[Interface], version: int) -> str:
    there = ", ".join(f"{interface.name} ({interface.address})" for interface in interfaces)
    return f"there are {there}" if there else f"no interface of this machine has an IPv{version} address"
