"""`ua-fleet pubsub record`, `replay` and `export` over a real broker."""

from __future__ import annotations

import asyncio
import importlib
import json
import signal
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from tests.integration.cli.conftest import command
from tests.integration.mqtt.broker import Broker
from tests.integration.mqtt.speaking import Speaking
from tests.system import Child, Processes, clean_environment, free_multicast_url
from tests.waiting import until
from ua_fleet.counters import Counters
from ua_fleet.pubsub import DataReceived, Publisher, PubSubTiming, Subscriber, make_field
from ua_fleet.recording.files import read_recording
from ua_fleet.topics import Topic
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.values import BuiltinType, StatusCode, ticks_from_unix_ns
from ua_fleet.wire import Codec

pytestmark = pytest.mark.needs("mosquitto")

dpkt: Any = importlib.import_module("dpkt")
"""It has no types."""
TOPIC = Topic(2, 2, 1001)
FIELDS = (make_field("level", BuiltinType.DOUBLE),)
TICKS = ticks_from_unix_ns(1_790_000_000_000_000_000)


def ended(child: Child) -> dict[str, Any]:
    child.process.wait(60)
    assert child.end() == 0, child.lines
    return next(json.loads(line) for line in child.lines if line.startswith("{"))


async def recorded(broker: Broker, file: Path, processes: Processes) -> None:
    """A publisher announces before anybody records, then says 20 values; Ctrl-C ends the recorder."""
    loop = asyncio.get_running_loop()
    bridge = Speaking(broker.url, TOPIC.space)
    await bridge.start()
    publisher = Publisher(TOPIC.space, PubSubTiming(), Counters(), Codec())
    try:
        for datagram in publisher.announce(TOPIC, "arm", FIELDS, now=loop.time(), wall_ticks=TICKS):
            bridge.transport.send(datagram)
        child = processes.start(
            *command("pubsub", "record", str(file), "--url", broker.url, "--json"), env=clean_environment()
        )
        child.wait_for("recording ", 60)
        async with asyncio.timeout(60):
            level = 0
            while level < 20 or not file.exists() or file.stat().st_size < 500:
                for datagram in publisher.publish(TOPIC, (float(level),), timestamp=TICKS + level, now=loop.time()):
                    bridge.transport.send(datagram)
                level += 1
                await asyncio.sleep(0.1)
        assert child.end(signal.SIGINT) == 130
    finally:
        await bridge.transport.close()


def replayed_in(datagrams: list[bytes]) -> list[DataReceived]:
    """What datagrams say in the name of a replay."""
    subscriber = Subscriber(7, PubSubTiming(), Counters(), Codec())
    return [
        event
        for now, datagram in enumerate(datagrams)
        for event in subscriber.receive(datagram, now / 1000)
        if isinstance(event, DataReceived) and event.topic.space == 65_535
    ]


async def test_what_a_broker_carried_is_exported_and_replayed(
    tmp_path: Path, broker: Broker, processes: Processes
) -> None:
    file = tmp_path / "line.rec"
    await recorded(broker, file, processes)
    header, found = read_recording(file)
    records = list(found)
    assert header.connections[0].url == broker.url
    kept = [record for record in records if record.is_kept]
    assert any("/metadata/2/" in record.sender[0] for record in kept)
    said = [record for record in records if record.sender[0] == TOPIC.name]
    assert len(said) > 10
    assert not any(record.is_kept for record in said)

    for name in ("line.mcap", "line.pcapng"):
        child = processes.start(
            *command("pubsub", "export", str(file), str(tmp_path / name), "--json"),
            env=clean_environment(UA_FLEET_CONFIG=str(tmp_path / "no.yaml")),
        )
        await asyncio.to_thread(ended, child)
    with (tmp_path / "line.mcap").open("rb") as opened:
        messages = [json.loads(message.data) for _, _, message in make_reader(opened).iter_messages()]
    levels = [message["fields"]["level"] for message in messages]
    assert levels == [levels[0] + number for number in range(len(levels))]
    assert len(levels) > 10
    with (tmp_path / "line.pcapng").open("rb") as opened:
        packets = [dpkt.ip.IP(content) for _, content in dpkt.pcapng.Reader(opened)]
    stream = b"".join(bytes(packet.data.data) for packet in packets if packet.data.sport == broker.port)
    assert all(record.datagram in stream for record in records)

    listening = Speaking(broker.url, 7)
    await listening.start()
    try:
        child = processes.start(
            *command("pubsub", "replay", str(file), "--to", broker.url, "--speed", "5", "--json"),
            env=clean_environment(),
        )
        figures = await asyncio.to_thread(ended, child)
    finally:
        await listening.transport.close()
    assert figures["sources"] == {TOPIC.name: "ua_65535_2_1001"}
    assert figures["values"] >= len(levels)
    events = replayed_in(listening.heard)
    good = [event for event in events if event.message.status == StatusCode.UNCERTAIN_SUBSTITUTE_VALUE]
    assert [event.message.values[0] for event in good] == levels[-len(good) :]
    assert len(good) > 10
    assert events[-1].message.status == StatusCode.BAD_NO_COMMUNICATION


async def test_a_replay_goes_by_the_connection_that_is_named_and_by_the_first_without_a_name(
    tmp_path: Path, broker: Broker, processes: Processes
) -> None:
    file, config, hall = tmp_path / "line.rec", tmp_path / "fleet.yaml", free_multicast_url()
    await recorded(broker, file, processes)
    config.write_text(
        "version: 1\n"
        "pubsub:\n"
        f'  - {{name: hall, security: none, url: "{hall}"}}\n'
        f'  - {{name: site, security: none, url: "{broker.url}"}}\n'
        "bridges: {floor: {kind: ros2, space: 2, status_id: 1900}}\n"
    )

    def replay(*options: str) -> Child:
        options = (str(file), "-c", str(config), "--speed", "10", "--json", *options)
        return processes.start(*command("pubsub", "replay", *options), env=clean_environment())

    in_hall: list[bytes] = []
    listening, site = UdpTransport(hall, "lo"), Speaking(broker.url, 7)
    await listening.start(lambda datagram, _sender: in_hall.append(datagram))
    await site.start()
    try:
        named = await asyncio.to_thread(ended, replay("--connection", "site"))
        assert named["values"] > 10
        at_site = replayed_in(site.heard)
        assert {event.topic for event in at_site} == {Topic(65_535, 2, 1001)}
        assert len(at_site) > 10
        assert in_hall == []
        site.heard.clear()
        first = await asyncio.to_thread(ended, replay())
        assert first["values"] == named["values"]
        await until(lambda: len(replayed_in(in_hall)) > 10)
        assert replayed_in(site.heard) == []
        unknown = replay("--connection", "yard")
        await asyncio.to_thread(unknown.process.wait, 60)
        assert unknown.end() == 3
        assert "ua-fleet: there is no connection 'yard' in `pubsub`; there are: `hall`, `site`" in unknown.lines
    finally:
        await site.transport.close()
        await listening.close()
