"""What `ua-fleet pubsub export` writes, and the keys that recordings are opened with."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

import zstandard

from ua_fleet.cli.opening import TOOL_SPACE, source_of
from ua_fleet.cli.output import message
from ua_fleet.cli.pubsub_decode import key_of
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import publisher_ids
from ua_fleet.counters import Counters
from ua_fleet.errors import KeySourceUnavailable, KeysRefused, TransportError
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.recording.files import read_recording
from ua_fleet.recording.mcap import McapWriter
from ua_fleet.recording.mqtt_stream import MqttStream
from ua_fleet.recording.opening import RecordedOpener
from ua_fleet.recording.pcapng import pcapng_parts
from ua_fleet.recording.playback import Playback
from ua_fleet.recording.records import Header, Record
from ua_fleet.transport.addresses import parse_url
from ua_fleet.transport.mqtt.address import is_broker_url, parse_broker_url
from ua_fleet.wire import MessageKey

__all__ = ["opener_of", "write_mcap", "write_pcapng"]

MOST_MESSAGE_BYTES = 64 * 1024 * 1024


async def opener_of(
    file: Path,
    header: Header,
    counters: Counters,
    fleet: FleetConfig | None,
    config_dir: Path,
    key: str | None,
    as_bridge: str | None,
) -> RecordedOpener:
    """What opens a recording: with one key, or with those keys of the fleet that its messages name."""
    opener = RecordedOpener(
        counters,
        TOOL_SPACE,
        setpoint_groups=dict(header.setpoint_groups),
        max_message_bytes=MOST_MESSAGE_BYTES,
        one_key=None if key is None else key_of(key),
        publisher_ids=None if fleet is None else publisher_ids(fleet),
    )
    if key is not None or fleet is None or not fleet.is_secured:
        return opener
    wanted = {record.key for record in read_recording(file)[1] if record.key.startswith("t-")}
    if not wanted:
        return opener
    if fleet.pubsub.keys.from_server and as_bridge is None:
        message("keys come from the key service: name a bridge with a trusted certificate (--as-bridge NAME)")
        return opener
    async with source_of(fleet, config_dir, as_bridge) as source:
        for name in sorted(wanted):
            group_id, _, token = name.partition("/")
            try:
                keys = await source.fetch(group_id, int(token), 1)
            except (KeysRefused, KeySourceUnavailable) as error:
                message(str(error))
                continue
            if keys.first_token_id == int(token):
                opener.keys[name] = MessageKey(keys.policy, keys.keys[0])
            else:
                message(f"the key {name} is not kept any more: what it secures stays closed")
    return opener


def write_pcapng(header: Header, records: Iterable[Record], out: BinaryIO) -> dict[str, int]:
    """Write a recording for Wireshark; says how many datagrams there are."""
    count = 0

    def counted() -> Iterator[Record]:
        nonlocal count
        for record in records:
            count += 1
            yield record

    for part in pcapng_parts(header, [_target(connection.url) for connection in header.connections], counted()):
        out.write(part)
    return {"datagrams": count}


def _target(url: str) -> tuple[str, int] | MqttStream:
    try:
        if is_broker_url(url):
            broker = parse_broker_url(url)
            return MqttStream(broker.host, broker.port, has_tls=broker.has_tls)
        return parse_url(url)
    except TransportError:
        return ("", 0)


async def write_mcap(
    file: Path,
    header: Header,
    records: Iterable[Record],
    out: BinaryIO,
    fleet: FleetConfig | None,
    config_dir: Path,
    key: str | None,
    as_bridge: str | None,
) -> dict[str, int]:
    """Write a recording for Foxglove; says how many values there are, and what was left out."""
    counters = Counters()
    opener = await opener_of(file, header, counters, fleet, config_dir, key, as_bridge)
    playback = Playback(counters, setpoint_groups=dict(header.setpoint_groups))
    writer = McapWriter(out.write, zstandard.ZstdCompressor().compress)
    values = datagrams = 0
    for record in records:
        datagrams += 1
        now = max(0.0, (record.time_ns - header.begun_ns) / 1e9)
        for fact in playback.feed(opener.open(record, now), now, is_fresh=not record.is_kept):
            if isinstance(fact, DataReceived):
                writer.add(fact.topic, fact.metadata, fact.message, record.time_ns)
                values += 1
    writer.end()
    dropped = {str(cause): count for cause, count in counters.drops.items() if count and cause != "repeated"}
    return {"datagrams": datagrams, "values": values, "commands_left_out": opener.left_out, **dropped}
