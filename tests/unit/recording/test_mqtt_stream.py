"""What a broker delivered, as a stream: TCP as dpkt reads it, MQTT as the library that the transport has reads it."""

from __future__ import annotations

import importlib
import io
from typing import Any

import pytest
from mqttium.codec.buffer import IncrementalDecoder
from mqttium.packets import ConnAckPacket, ConnectPacket, PublishPacket

from tests.unit.recording.recorded import BEGUN_NS
from tests.unit.recording.test_exports import checksum_fits
from ua_fleet.recording.mqtt_stream import MqttStream
from ua_fleet.recording.pcapng import MADE_UP, pcapng_parts
from ua_fleet.recording.records import Connection, Header, Record

dpkt: Any = importlib.import_module("dpkt")
"""It has no types."""
URL = "mqtt://192.0.2.9:1884"
HEADER = Header(BEGUN_NS, (Connection(URL, "lo"),))
RECORDS = [
    Record(BEGUN_NS + 1_000, 0, ("opcua/uadp/metadata/2/group-2/arm", 0), "", b"kept before", is_kept=True),
    Record(BEGUN_NS + 2_000, 0, ("ua_2_2_1001", 0), "t-2/7", b"x" * 5_000),
    Record(BEGUN_NS + 3_000, 0, ("ua_2_2_1002", 0), "", b""),
]


def packets_of(host: str, port: int, *, has_tls: bool = False) -> list[tuple[float, Any]]:
    content = b"".join(pcapng_parts(HEADER, [MqttStream(host, port, has_tls=has_tls)], RECORDS))
    assert MADE_UP.encode() in content
    kind = dpkt.ip6.IP6 if ":" in host else dpkt.ip.IP
    return [(at, kind(packet)) for at, packet in dpkt.pcapng.Reader(io.BytesIO(content))]


def streams(packets: list[tuple[float, Any]], port: int) -> tuple[bytes, bytes]:
    """What client and broker sent; each segment has to follow the one before."""
    sent = {True: b"", False: b""}
    for _, packet in packets:
        segment = packet.data
        assert isinstance(segment, dpkt.tcp.TCP)
        assert checksum_fits(packet, segment, 6)
        is_broker = segment.sport == port
        assert is_broker or segment.dport == port
        if segment.flags & dpkt.tcp.TH_SYN:
            assert segment.seq == 0
            continue
        assert segment.seq == 1 + len(sent[is_broker])
        assert segment.ack == 1 + len(sent[not is_broker])
        sent[is_broker] += bytes(segment.data)
    return sent[False], sent[True]


def mqtt(content: bytes) -> list[Any]:
    decoder = IncrementalDecoder()
    decoder.feed(content)
    return list(decoder.drain_packets())


@pytest.mark.parametrize("host", ["192.0.2.9", "broker.example", "2001:db8::9"])
def test_it_is_the_connection_of_a_client(host: str) -> None:
    packets = packets_of(host, 1884)
    client, broker = streams(packets, 1884)
    assert client == ConnectPacket("recording", keepalive=0).encode()
    accepted, *published = mqtt(broker)
    assert ConnAckPacket.decode(bytes(accepted.remaining)).reason_code == 0
    read = [PublishPacket.decode(one.flags, bytes(one.remaining)) for one in published]
    assert [(one.topic, one.payload, one.retain) for one in read] == [
        (record.sender[0], record.datagram, record.is_kept) for record in RECORDS
    ]
    assert abs(packets[-1][0] - (BEGUN_NS + 3_000) / 1e9) < 1e-6


def test_what_came_encrypted_is_shown_at_the_port_of_plain_mqtt() -> None:
    assert streams(packets_of("192.0.2.9", 8883, has_tls=True), 1883)[1]
