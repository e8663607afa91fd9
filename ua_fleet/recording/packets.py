"""IP packets around what was recorded: UDP (RFC 768) and TCP (RFC 9293), with their checksums. Pure."""

from __future__ import annotations

import ipaddress
from struct import Struct
from typing import Final

__all__ = ["MOST_PAYLOAD", "IpAddress", "tcp_packet", "udp_packet"]

IpAddress = ipaddress.IPv4Address | ipaddress.IPv6Address

_TCP, _UDP = 6, 17
_TTL: Final = 1
_IPV4_HEAD: Final = Struct("!BBHHHBBH4s4s")
_IPV6_HEAD: Final = Struct("!IHBB16s16s")
_UDP_HEAD: Final = Struct("!HHHH")
_TCP_HEAD: Final = Struct("!HHIIBBHHH")
_TCP_WORDS: Final = 5 << 4
_WINDOW: Final = 0xFFFF
MOST_PAYLOAD: Final = 0xFFFF - _IPV4_HEAD.size - _UDP_HEAD.size
"""Of a datagram over IPv4."""


def udp_packet(source: tuple[IpAddress, int], target: tuple[IpAddress, int], payload: bytes) -> bytes:
    """A datagram of at most `MOST_PAYLOAD` bytes; both addresses are of one IP version."""
    head = _UDP_HEAD.pack(source[1], target[1], _UDP_HEAD.size + len(payload), 0)
    return _packet(source[0], target[0], _UDP, head, 6, payload)


def tcp_packet(
    source: tuple[IpAddress, int],
    target: tuple[IpAddress, int],
    payload: bytes,
    *,
    sequence: int,
    acknowledged: int,
    flags: int,
) -> bytes:
    """A segment; both addresses are of one IP version."""
    numbers = sequence & 0xFFFF_FFFF, acknowledged & 0xFFFF_FFFF
    head = _TCP_HEAD.pack(source[1], target[1], *numbers, _TCP_WORDS, flags, _WINDOW, 0, 0)
    return _packet(source[0], target[0], _TCP, head, 16, payload)


def _packet(
    source: IpAddress, target: IpAddress, protocol: int, head: bytes, checksum_at: int, payload: bytes
) -> bytes:
    size = len(head) + len(payload)
    pseudo = source.packed + target.packed
    pseudo += size.to_bytes(4, "big") + protocol.to_bytes(4, "big")  # of IPv4 in other order, with the same sum
    checksum = _checksum(pseudo + head + payload)
    if protocol == _UDP:
        checksum = checksum or 0xFFFF  # 0 would say that there is none
    content = head[:checksum_at] + checksum.to_bytes(2, "big") + head[checksum_at + 2 :] + payload
    if source.version == 6:
        return _IPV6_HEAD.pack(6 << 28, size, protocol, _TTL, source.packed, target.packed) + content
    fields = (0x45, 0, _IPV4_HEAD.size + size, 0, 0, _TTL, protocol)
    ends = source.packed, target.packed
    return _IPV4_HEAD.pack(*fields, _checksum(_IPV4_HEAD.pack(*fields, 0, *ends)), *ends) + content


def _checksum(content: bytes) -> int:
    """The Internet checksum (RFC 1071)."""
    total = int.from_bytes(content + bytes(len(content) % 2), "big") % 0xFFFF  # 2**16 is 1 modulo 2**16 - 1
    return ~total & 0xFFFF
