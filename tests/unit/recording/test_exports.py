"""Recordings for other programs: MCAP as its own library reads it, pcapng as dpkt reads it."""

from __future__ import annotations

import importlib
import io
import ipaddress
import json
import socket
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import zstandard
from mcap.reader import make_reader

from tests.unit.pubsub.publishing import WALL, only
from tests.unit.recording.recorded import ARM, BEGUN_NS, HEADER, LEG, SENDER, Recording
from ua_fleet.counters import Counters
from ua_fleet.pubsub import DataReceived, make_field
from ua_fleet.recording.mcap import McapWriter
from ua_fleet.recording.pcapng import pcapng_parts
from ua_fleet.recording.playback import Playback
from ua_fleet.recording.records import Connection, Header, Record
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, LocalizedText, Matrix, StatusCode
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData, FieldMetaData

dpkt: Any = importlib.import_module("dpkt")
"""It has no types."""
COMPRESS = zstandard.ZstdCompressor().compress


def exported(recording: Recording) -> bytes:
    out = io.BytesIO()
    writer, playback = McapWriter(out.write, COMPRESS), Playback(Counters())
    for record in recording.records:
        facts = playback.feed(record.datagram, (record.time_ns - BEGUN_NS) / 1e9)
        for event in only(DataReceived, facts):
            writer.add(event.topic, event.metadata, event.message, record.time_ns)
    writer.end()
    return out.getvalue()


def read(content: bytes, **which: Any) -> list[tuple[str, int, int, dict[str, Any]]]:
    reader = make_reader(io.BytesIO(content), validate_crcs=True)
    return [
        (channel.topic, message.log_time, message.publish_time, json.loads(message.data))
        for schema, channel, message in reader.iter_messages(**which)
        if schema is not None
    ]


def test_each_data_set_is_a_channel_with_its_schema() -> None:
    recording = Recording()
    recording.announce(ARM)
    recording.announce(LEG, fields=(make_field("on", BuiltinType.BOOLEAN), make_field("name", BuiltinType.STRING)))
    for step in range(3):
        recording.now = step / 2
        recording.publish(ARM, float(step))
        recording.publish(LEG, step % 2 == 0, status=int(StatusCode.UNCERTAIN))
    content = exported(recording)
    reader = make_reader(io.BytesIO(content), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 6
    assert {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()} == {
        "ua_1_2_1001": "data 1001",
        "ua_1_2_1002": "data 1002",
    }
    for schema, _, message in reader.iter_messages():
        assert schema is not None
        assert schema.encoding == "jsonschema"
        jsonschema.validate(json.loads(message.data), json.loads(schema.data))
    arm = [one for one in read(content) if one[0] == ARM.name]
    assert [(at - BEGUN_NS, published - BEGUN_NS) for _, at, published, _ in arm] == [
        (step * 500_000_000, step * 500_000_000) for step in range(3)
    ]
    assert arm[2][3] == {
        "time": "2025-08-18T14:13:21.0000000Z",
        "status": "Good",
        "fields": {"level": 2.0, "name": "a"},
    }
    later = read(content, topics=[LEG.name], starting_at=BEGUN_NS + 1)
    assert [one[3]["fields"]["on"] for one in later] == [False, True]
    assert later[0][3]["status"] == "Uncertain"


def test_many_messages_are_many_chunks_that_are_found_by_their_times() -> None:
    out = io.BytesIO()
    writer = McapWriter(out.write, COMPRESS)
    metadata = DataSetMetaData("wide", (FieldMetaData("f", 12),), ConfigurationVersion(1, 1))
    message = DataSetMessage(1001, types=(12,), values=("x" * 10_000,), timestamp=WALL)
    for number in range(500):
        writer.add(ARM if number % 3 else LEG, metadata, message, BEGUN_NS + number)
    writer.end()
    reader = make_reader(io.BytesIO(out.getvalue()), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) > 3
    part = read(out.getvalue(), starting_at=BEGUN_NS + 400, ending_before=BEGUN_NS + 410)
    assert [at - BEGUN_NS for _, at, _, _ in part] == list(range(400, 410))
    assert len(read(out.getvalue(), topics=[LEG.name])) == 167


VALUES: list[tuple[str, FieldMetaData, int, Any, Any]] = [
    ("Int64", FieldMetaData("f", 8), 8, -5, -5),
    ("NaN", FieldMetaData("f", 11), 11, float("nan"), None),
    ("infinity", FieldMetaData("f", 10), 10, float("inf"), None),
    ("DateTime", FieldMetaData("f", 13), 13, WALL + 7, "2025-08-18T14:13:20.0000007Z"),
    ("ByteString", FieldMetaData("f", 15), 15, b"\x00\xff", "AP8="),
    ("null", FieldMetaData("f", 12), 12, None, None),
    ("Bad field", FieldMetaData("f", 11), 19, 0x8000_0000, None),
    ("StatusCode", FieldMetaData("f", 19), 19, 0x8000_0000, 0x8000_0000),
    ("LocalizedText", FieldMetaData("f", 21), 21, LocalizedText("text"), "text"),
    ("array", FieldMetaData("f", 11, value_rank=1), 0x8B, (1.0, float("nan")), [1.0, None]),
    ("view", FieldMetaData("f", 10, value_rank=1), 0x8A, memoryview(bytes(8)).cast("f"), [0.0, 0.0]),
    ("matrix", FieldMetaData("f", 6, value_rank=2), 0xC6, Matrix((1, 2), (1, 2)), [1, 2]),
]


@pytest.mark.parametrize(("of", "code", "value", "expected"), [pytest.param(*row[1:], id=row[0]) for row in VALUES])
def test_each_value_is_json(of: FieldMetaData, code: int, value: Any, expected: Any) -> None:
    out = io.BytesIO()
    writer = McapWriter(out.write, COMPRESS)
    metadata = DataSetMetaData("one", (of,), ConfigurationVersion(1, 1))
    writer.add(Topic(1, 2, 3), metadata, DataSetMessage(3, types=(code,), values=(value,)), 5)
    writer.end()
    [(_, at, published, content)] = read(out.getvalue())
    assert (at, published) == (5, 5)
    assert content == {"time": None, "status": "Good", "fields": {"f": expected}}


def test_nothing_is_a_file_too() -> None:
    assert read(exported(Recording())) == []


TARGET = ("224.0.2.14", 4840)
RECORDS = [
    Record(BEGUN_NS + 1, 0, SENDER, "", b"first"),
    Record(BEGUN_NS + 2, 1, ("fe80::7%3", 50_001), "t-1/7", b"odd"),
    Record(BEGUN_NS + 3, 0, SENDER, "", b"x" * 65_507),
    Record(BEGUN_NS + 4, 0, ("::1", 1), "", b"another version than its group"),
    Record(BEGUN_NS + 5, 7, SENDER, "", b"of no connection"),
]


def test_datagrams_are_packets_with_the_addresses_and_times_that_they_had(tmp_path: Path) -> None:
    header = Header(BEGUN_NS, (*HEADER.connections, Connection("opc.udp://[ff02::7]:4840", "eth0")))
    path = tmp_path / "line.pcapng"
    path.write_bytes(b"".join(pcapng_parts(header, [TARGET, ("ff02::7", 4840)], RECORDS)))
    with path.open("rb") as file:
        packets = [(at, content) for at, content in dpkt.pcapng.Reader(file)]
    assert len(packets) == 3
    for (at, content), record in zip(packets, RECORDS[:3], strict=True):
        assert abs(at - record.time_ns / 1e9) < 1e-6
        is_ipv6 = content[0] >> 4 == 6
        packet = dpkt.ip6.IP6(content) if is_ipv6 else dpkt.ip.IP(content)
        udp = packet.data
        assert isinstance(udp, dpkt.udp.UDP)
        assert bytes(udp.data) == record.datagram
        assert (udp.sport, udp.dport) == (record.sender[1], 4840)
        kind = socket.AF_INET6 if is_ipv6 else socket.AF_INET
        assert socket.inet_ntop(kind, packet.src) == record.sender[0].partition("%")[0]
        assert socket.inet_ntop(kind, packet.dst) == ("ff02::7" if is_ipv6 else TARGET[0])
        assert checksum_fits(packet, udp)


def checksum_fits(packet: Any, part: Any, protocol: int = 17) -> bool:
    """As a receiver sees it: headers and payload with their checksums sum up to all ones (RFC 768, RFC 1071)."""
    size = len(bytes(part))
    pseudo = packet.src + packet.dst + size.to_bytes(4, "big") + protocol.to_bytes(4, "big")

    def ones(content: bytes) -> bool:
        content += bytes(len(content) % 2)
        total = sum(int.from_bytes(content[at : at + 2], "big") for at in range(0, len(content), 2))
        while total >> 16:
            total = (total & 0xFFFF) + (total >> 16)
        return total == 0xFFFF

    if ipaddress.ip_address(packet.src).version == 4 and not ones(bytes(packet)[:20]):
        return False
    return ones(pseudo + bytes(packet)[-size:])
