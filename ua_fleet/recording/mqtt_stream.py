"""What came from an MQTT broker as a TCP stream that it could have come in, for programs that read MQTT. Pure.

A recording has the topic and the payload of each message, whether it was retained, and when it came: not the bytes of
its connection, which may have been encrypted. They are made here, as MQTT 3.1.1 (OASIS) with QoS 0.
"""

from __future__ import annotations

import ipaddress
from typing import Final

from ua_fleet.recording.packets import IpAddress, tcp_packet
from ua_fleet.recording.records import Record

__all__ = ["MqttStream"]

_SYN, _PUSH_ACK, _SYN_ACK, _ACK = 0x02, 0x18, 0x12, 0x10
_SEGMENT_BYTES: Final = 1400
_CLIENT_PORT: Final = 50_000
_PLAIN_PORT: Final = 1883
"""By which programs know MQTT; that of TLS would tell them to look for TLS."""
_CLIENT_ID: Final = b"recording"
_CONNECT: Final = b"\x00\x04MQTT\x04\x02\x00\x00" + len(_CLIENT_ID).to_bytes(2, "big") + _CLIENT_ID
_CONNACK: Final = b"\x20\x02\x00\x00"
_PUBLISH, _RETAIN = 0x30, 0x01


class MqttStream:
    """One connection of a recorder to a broker."""

    def __init__(self, host: str, port: int, *, has_tls: bool) -> None:
        """`host` and `port` are the broker's; a name has an address for documentation (RFC 5737) in its place."""
        try:
            broker: IpAddress = ipaddress.ip_address(host)
        except ValueError:
            broker = ipaddress.ip_address("192.0.2.1")
        client: IpAddress = ipaddress.ip_address("192.0.2.2" if broker.version == 4 else "2001:db8::2")
        self._broker = broker, _PLAIN_PORT if has_tls else port
        self._client = client, _CLIENT_PORT
        self._sent = 0
        """By the broker, of which its next sequence number is one more."""
        self._received = 0

    def opening(self) -> list[bytes]:
        """The packets by which the connection begins."""
        connect = bytes((0x10,)) + _length(len(_CONNECT)) + _CONNECT
        packets = [
            tcp_packet(self._client, self._broker, b"", sequence=0, acknowledged=0, flags=_SYN),
            tcp_packet(self._broker, self._client, b"", sequence=0, acknowledged=1, flags=_SYN_ACK),
            tcp_packet(self._client, self._broker, b"", sequence=1, acknowledged=1, flags=_ACK),
            tcp_packet(self._client, self._broker, connect, sequence=1, acknowledged=1, flags=_PUSH_ACK),
        ]
        self._received = len(connect)
        return packets + self._segments(_CONNACK)

    def publish(self, record: Record) -> list[bytes]:
        """The packets in which a message comes."""
        topic = record.sender[0].encode()[:0xFFFF]
        body = len(topic).to_bytes(2, "big") + topic + record.datagram
        return self._segments(bytes((_PUBLISH | (_RETAIN if record.is_kept else 0),)) + _length(len(body)) + body)

    def _segments(self, content: bytes) -> list[bytes]:
        packets: list[bytes] = []
        for at in range(0, len(content), _SEGMENT_BYTES):
            part = content[at : at + _SEGMENT_BYTES]
            packets.append(
                tcp_packet(
                    self._broker,
                    self._client,
                    part,
                    sequence=1 + self._sent,
                    acknowledged=1 + self._received,
                    flags=_PUSH_ACK,
                )
            )
            self._sent += len(part)
        return packets


def _length(size: int) -> bytes:
    """A Remaining Length (MQTT 3.1.1, 2.2.3)."""
    encoded = bytearray()
    while True:
        size, low = divmod(size, 0x80)
        encoded.append(low | (0x80 if size else 0))
        if not size:
            return bytes(encoded)
