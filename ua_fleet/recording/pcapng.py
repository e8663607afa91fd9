"""pcapng (IETF draft-ietf-opsawg-pcapng), which Wireshark opens: the datagrams as they were received.

The IP and UDP headers are made from the addresses that the recording has; what else was in them is not known. What came
from an MQTT broker stands in a TCP stream that is made up. An interface stands for each connection.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable, Iterator, Sequence
from struct import Struct
from typing import Final

from ua_fleet.recording.mqtt_stream import MqttStream
from ua_fleet.recording.packets import MOST_PAYLOAD, udp_packet
from ua_fleet.recording.records import Header, Record

__all__ = ["MADE_UP", "pcapng_parts"]

_SECTION, _INTERFACE, _PACKET = 0x0A0D_0D0A, 1, 6
_RAW_IP: Final = 101
_BLOCK: Final = Struct("<II")
_SECTION_BODY: Final = Struct("<IHHq")
_INTERFACE_BODY: Final = Struct("<HHI")
_PACKET_BODY: Final = Struct("<IIIII")
_OPTION: Final = Struct("<HH")
_NAME, _RESOLUTION, _COMMENT = 2, 9, 1
_NANOSECONDS: Final = 9
MADE_UP: Final = "this connection is made up: a recording has MQTT messages, and not the bytes that they came in"


def pcapng_parts(
    header: Header, targets: Sequence[tuple[str, int] | MqttStream], records: Iterable[Record]
) -> Iterator[bytes]:
    """The blocks of the file; `targets` are where the connections of the header sent to: an address, or a broker."""
    yield _block(_SECTION, _SECTION_BODY.pack(0x1A2B_3C4D, 1, 0, -1))
    for connection in header.connections:
        options = _option(_NAME, connection.url.encode()) + _option(_RESOLUTION, bytes((_NANOSECONDS,)))
        yield _block(_INTERFACE, _INTERFACE_BODY.pack(_RAW_IP, 0, 0) + options + _OPTION.pack(0, 0))
    for number, target in enumerate(targets):
        if isinstance(target, MqttStream):
            for packet in target.opening():
                yield _packet(number, header.begun_ns, packet, MADE_UP)
    for record in records:
        if record.connection >= len(targets):
            continue
        target = targets[record.connection]
        packets = target.publish(record) if isinstance(target, MqttStream) else _datagram(record, target)
        for packet in packets:
            yield _packet(record.connection, record.time_ns, packet, record.key)


def _packet(interface: int, time_ns: int, packet: bytes, comment: str) -> bytes:
    high, low = divmod(time_ns, 1 << 32)
    head = _PACKET_BODY.pack(interface, high & 0xFFFF_FFFF, low, len(packet), len(packet))
    options = _option(_COMMENT, comment.encode()) + _OPTION.pack(0, 0) if comment else b""
    return _block(_PACKET, head + _padded(packet) + options)


def _block(kind: int, body: bytes) -> bytes:
    size = len(body) + 12
    return _BLOCK.pack(kind, size) + body + size.to_bytes(4, "little")


def _option(code: int, value: bytes) -> bytes:
    return _OPTION.pack(code, len(value)) + _padded(value)


def _padded(content: bytes) -> bytes:
    return content + bytes(-len(content) % 4)


def _datagram(record: Record, target: tuple[str, int]) -> list[bytes]:
    """The packet that a datagram must have come in; none where the recording does not know the addresses."""
    try:
        source = ipaddress.ip_address(record.sender[0].partition("%")[0])
        destination = ipaddress.ip_address(target[0].partition("%")[0])
    except ValueError:
        return []
    if source.version != destination.version or len(record.datagram) > MOST_PAYLOAD:
        return []
    return [udp_packet((source, record.sender[1]), (destination, target[1]), record.datagram)]
