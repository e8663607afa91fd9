"""Network interfaces by name, IPv4 address or subnet."""

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
_REQUEST_BYTES: Final = 40
"""Size of `struct ifreq` on 64-bit machines."""
_INET6: Final = Path("/proc/net/if_inet6")
_MOST_ADDRESSES: Final = 256
_LOOPBACK: Final = ipaddress.IPv4Network("127.0.0.0/8")


@dataclass(frozen=True, slots=True)
class Interface:
    """An interface as it is now. While it stays equal, sockets made for it stay good."""

    name: str
    index: int
    address: str
    """One of its IPv4 addresses: the one asked for, the first in the subnet asked for, or the first."""
    is_up: bool


def list_interfaces() -> list[Interface]:
    """All IPv4 addresses of this machine with their interfaces."""
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
                flags_request = struct.pack(f"{_REQUEST_BYTES}s", name.encode())
                flags: int = struct.unpack_from("H", fcntl.ioctl(probe, _SIOCGIFFLAGS, flags_request), 16)[0]
                address = socket.inet_ntoa(request[20:24])
                interfaces.append(Interface(name, socket.if_nametoindex(name), address, bool(flags & _IFF_UP)))
    return interfaces


def interface_state(probe: socket.socket, name: str) -> bytes:
    """What has to change before `find_interface` finds another interface in place of this one; of any socket.

    Four calls of the kernel, and nothing is read of their answers: a tenth of what it takes to look.
    """
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
    found = [interface.address for interface in list_interfaces() if interface.is_up]
    with contextlib.suppress(OSError):  # a kernel without IPv6
        lines = _INET6.read_text(encoding="ascii").splitlines()
        found += [str(ipaddress.IPv6Address(int(line.split()[0], 16))) for line in lines]
    addresses = [ipaddress.ip_address(address) for address in dict.fromkeys(found)]
    return [str(address) for address in addresses if not (address.is_loopback or address.is_link_local)]


def find_interface(wanted: str) -> Interface:
    """The interface with this name or IPv4 address, or with an address in this subnet (`192.168.1.0/24`).

    A subnet is for machines that get their address and the order of their interfaces from others: with DHCP, and in
    containers. Where several addresses are in it, it is the first one.

    Raises:
        TransportError: there is none, or it has no IPv4 address; names those that are there.
    """
    interfaces = list_interfaces()
    if "/" in wanted:  # which the kernel allows in no interface's name
        return _find_in_subnet(wanted, interfaces)
    for interface in interfaces:
        if wanted in (interface.name, interface.address):
            return interface
    there = _what_is_there(interfaces)
    try:
        address = ipaddress.IPv4Address(wanted)
    except ValueError:
        if any(name == wanted for _, name in socket.if_nameindex()):
            remedy = f"give it one (ip addr add <address> dev {wanted})"
            raise TransportError(f"network interface {wanted} has no IPv4 address: {remedy}; {there}") from None
        raise TransportError(f"there is no network interface {wanted!r}; {there}") from None
    if address in _LOOPBACK:  # all of 127/8 is ours without being listed
        for interface in interfaces:
            if interface.address.startswith("127."):
                return Interface(interface.name, interface.index, wanted, interface.is_up)
    raise TransportError(f"no network interface has the address {wanted}; {there}")


def _find_in_subnet(wanted: str, interfaces: list[Interface]) -> Interface:
    try:
        subnet = ipaddress.IPv4Network(wanted)
    except ValueError as error:
        raise TransportError(f"{wanted!r} is no subnet such as 192.168.1.0/24: {error}") from None
    for interface in interfaces:
        if ipaddress.IPv4Address(interface.address) in subnet:
            return interface
    raise TransportError(f"no network interface has an address in {subnet}; {_what_is_there(interfaces)}")


def _what_is_there(interfaces: list[Interface]) -> str:
    there = ", ".join(f"{interface.name} ({interface.address})" for interface in interfaces)
    return f"there are {there}" if there else "no interface of this machine has an IPv4 address"
