"""pcapng (IETF draft-ietf-opsawg-pcapng), which Wireshark opens: the datagrams as they were received.

The IP and UDP headers are made from the addresses that the recording has; what else was in them is not known. An
interface stands for each connection.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable, Iterator
from struct import Struct
from typing import Final

from ua_fleet.recording.records import Header, Record

__all__ = ["pcapng_parts"]

_SECTION, _INTERFACE, _PACKET = 0x0A0D_0D0A, 1, 6
_RAW_IP: Final = 101
_UDP: Final = 17
_TTL: Final = 1
_BLOCK: Final = Struct("<II")
_SECTION_BODY: Final = Struct("<IHHq")
_INTERFACE_BODY: Final = Struct("<HHI")
_PACKET_BODY: Final = Struct("<IIIII")
_OPTION: Final = Struct("<HH")
_NAME, _RESOLUTION, _COMMENT = 2, 9, 1
_NANOSECONDS: Final = 9
_UDP_HEAD: Final = Struct("!HHHH")
_IPV4_HEAD: Final = Struct("!BBHHHBBH4s4s")
_IPV6_HEAD: Final = Struct("!IHBB16s16s")
_MOST_IPV4_PAYLOAD: Final = 0xFFFF - _IPV4_HEAD.size - _UDP_HEAD.size


def pcapng_parts(header: Header, targets: list[tuple[str, int]], records: Iterable[Record]) -> Iterator[bytes]:
    """The blocks of the file; `targets` are the addresses that the connections of the header sent to."""
    yield _block(_SECTION, _SECTION_BODY.pack(0x1A2B_3C4D, 1, 0, -1))
    for connection in header.connections:
        options = _option(_NAME, connection.url.encode()) + _option(_RESOLUTION, bytes((_NANOSECONDS,)))
        yield _block(_INTERFACE, _INTERFACE_BODY.pack(_RAW_IP, 0, 0) + options + _OPTION.pack(0, 0))
    for record in records:
        if record.connection >= len(targets):
            continue
        packet = _packet(record, targets[record.connection])
        if packet is None:
            continue
        high, low = divmod(record.time_ns, 1 << 32)
        head = _PACKET_BODY.pack(record.connection, high & 0xFFFF_FFFF, low, len(packet), len(packet))
        options = _option(_COMMENT, record.key.encode()) + _OPTION.pack(0, 0) if record.key else b""
        yield _block(_PACKET, head + _padded(packet) + options)


def _block(kind: int, body: bytes) -> bytes:
    size = len(body) + 12
    return _BLOCK.pack(kind, size) + body + size.to_bytes(4, "little")


def _option(code: int, value: bytes) -> bytes:
    return _OPTION.pack(code, len(value)) + _padded(value)


def _padded(content: bytes) -> bytes:
    return content + bytes(-len(content) % 4)


def _packet(record: Record, target: tuple[str, int]) -> bytes | None:
    """The datagram behind the headers that it must have had; None where the recording does not know the addresses."""
    try:
        source = ipaddress.ip_address(record.sender[0].partition("%")[0])
        destination = ipaddress.ip_address(target[0].partition("%")[0])
    except ValueError:
        return None
    if source.version != destination.version or len(record.datagram) > _MOST_IPV4_PAYLOAD:
        return None
    size = _UDP_HEAD.size + len(record.datagram)
    head = _UDP_HEAD.pack(record.sender[1], target[1], size, 0)
    pseudo = source.packed + destination.packed
    pseudo += size.to_bytes(4, "big") + _UDP.to_bytes(4, "big")  # of IPv4 in other order, with the same sum
    checksum = _checksum(pseudo + head + record.datagram) or 0xFFFF
    udp = head[:6] + checksum.to_bytes(2, "big") + record.datagram
    if source.version == 6:
        return _IPV6_HEAD.pack(6 << 28, size, _UDP, _TTL, source.packed, destination.packed) + udp
    fields = (0x45, 0, _IPV4_HEAD.size + size, 0, 0, _TTL, _UDP)
    checksum = _checksum(_IPV4_HEAD.pack(*fields, 0, source.packed, destination.packed))
    return _IPV4_HEAD.pack(*fields, checksum, source.packed, destination.packed) + udp


def _checksum(content: bytes) -> int:
    """The Internet checksum (RFC 1071)."""
    total = int.from_bytes(content + bytes(len(content) % 2), "big") % 0xFFFF  # 2**16 is 1 modulo 2**16 - 1
    return ~total & 0xFFFF
