"""`ua-fleet pubsub record`, `replay` and `export` as processes, over real UDP."""

from __future__ import annotations

import asyncio
import importlib
import json
import signal
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from tests.integration.cli.conftest import command
from tests.system import Child, Processes, clean_environment, free_multicast_url
from ua_fleet.config.load import load
from ua_fleet.config.security import all_groups, envelope_of
from ua_fleet.counters import Counters
from ua_fleet.keys.files import FileKeySource
from ua_fleet.pubsub import DataReceived, Publisher, PubSubTiming, Subscriber, make_field
from ua_fleet.pubsub.events import ProbeReceived, SourceUnknown
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.recording.files import read_recording
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.topics import Topic
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.values import BuiltinType, StatusCode, ticks_from_unix_ns
from ua_fleet.wire import Codec, SecurityMode, encode_action
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.security import SecurityPolicy

dpkt: Any = importlib.import_module("dpkt")
"""It has no types."""
TOPIC, OTHER = Topic(2, 2, 1001), Topic(2, 2, 2001)
FLEET = """\
version: 1
pubsub: {{security: {security}, url: {url}, keys: {{source: files}}}}
bridges: {{floor: {{kind: ros2, space: 2, status_id: 1900}}}}
"""
FIELDS = (make_field("level", BuiltinType.DOUBLE), make_field("name", BuiltinType.STRING))


def fleet(folder: Path, url: str, security: str = "none") -> Path:
    path = folder / "fleet.yaml"
    path.write_text(FLEET.format(url=url, security=security))
    if security != "none":
        keys = KeyFolder(folder / "keys")
        for group_id in (*all_groups(load(path, {})), "t-65535"):
            keys.write(KeyFile.new(group_id, SecurityPolicy.AES256_CTR, 3600.0, time.time()))
    return path


async def keyed(config: Path, space: int, *groups: str) -> Envelope:
    loaded = load(config, {})
    envelope = envelope_of(loaded, space, Counters(), config.parent / f"state-{space}")
    if envelope.mode is not SecurityMode.NONE:
        source = FileKeySource(config.parent / "keys", SecurityPolicy.AES256_CTR)
        for group_id in groups:
            envelope.want(group_id)
            envelope.install(group_id, await source.fetch(group_id, 0, 2), asyncio.get_running_loop().time())
    return envelope


@asynccontextmanager
async def publishing(config: Path, url: str, *topics: Topic) -> AsyncGenerator[Callable[[float], bytes]]:
    """A bridge of space 2 with these sources, which answers probes; a test says their values."""
    loop = asyncio.get_running_loop()
    envelope = await keyed(config, TOPIC.space, "t-2", "c-2")
    publisher = Publisher(TOPIC.space, PubSubTiming(), Counters(), Codec())
    subscriber = Subscriber(TOPIC.space, PubSubTiming(), Counters(), Codec(), envelope=envelope)
    transport = UdpTransport(url, "lo")

    def send(plain: list[bytes]) -> bytes:
        """Send messages; the last datagram of them."""
        sent = [datagram for message in plain for datagram in envelope.seal(message, loop.time())]
        for datagram in sent:
            transport.send(datagram)
        return sent[-1]

    def receive(datagram: bytes, sender: tuple[str, int]) -> None:
        for event in subscriber.receive(datagram, loop.time(), sender):
            if isinstance(event, ProbeReceived):
                send(publisher.answer(event.probe, loop.time()))

    def publish(level: float) -> bytes:
        ticks = ticks_from_unix_ns(time.time_ns())
        for topic in topics:
            send(publisher.publish(topic, (level, "a"), timestamp=ticks, now=loop.time()))
        action = ActionMessage(
            2,
            2,
            7,
            1,
            1,
            ActionState.EXECUTING,
            is_request=True,
            requestor_id="0.a",
            correlation_data=str(level).encode(),
        )
        return send([encode_action(action)])

    await transport.start(receive)
    try:
        for topic in topics:
            publisher.announce(topic, "arm", FIELDS, now=loop.time(), wall_ticks=ticks_from_unix_ns(time.time_ns()))
        yield publish
    finally:
        await transport.close()


async def recorded(
    config: Path, url: str, file: Path, processes: Processes, topics: tuple[Topic, ...] = (TOPIC,)
) -> list[float]:
    """Record until the file has the metadata and 60 values, then end the recorder as Ctrl-C does."""
    child = processes.start(
        *command("pubsub", "record", str(file), "-c", str(config), "--json"), env=clean_environment()
    )
    child.wait_for("recording ", 60)
    said: list[float] = []
    async with publishing(config, url, *topics) as publish:
        async with asyncio.timeout(60):
            last = b""
            while len(said) < 60 or not file.exists():
                last = publish(float(len(said)))
                said.append(float(len(said)))
                await asyncio.sleep(0.05)
            while last not in (record.datagram for record in read_recording(file)[1]):
                await asyncio.sleep(0.05)
    assert child.end(signal.SIGINT) == 130
    return said


def ended(child: Child) -> dict[str, Any]:
    child.process.wait(60)
    assert child.end() == 0, child.lines
    return next(json.loads(line) for line in child.lines if line.startswith("{"))


class Listening:
    """Who hears the replay: a server's subscriber."""

    def __init__(self, envelope: Envelope | None) -> None:
        self.values: list[DataReceived] = []
        self.kinds: set[str] = set()
        self._subscriber = Subscriber(0, PubSubTiming(), Counters(), Codec(), envelope=envelope)
        self.transport: UdpTransport | None = None

    async def start(self, url: str) -> None:
        self.transport = UdpTransport(url, "lo")
        await self.transport.start(self._receive)

    def _receive(self, datagram: bytes, sender: tuple[str, int]) -> None:
        now = asyncio.get_running_loop().time()
        for event in (*self._subscriber.receive(datagram, now, sender), *self._subscriber.poll(now)):
            self.kinds.add(type(event).__name__)
            if isinstance(event, DataReceived):
                self.values.append(event)
            elif isinstance(event, SourceUnknown) and event.datagram is not None and self.transport is not None:
                self.transport.send(event.datagram)


async def test_what_was_said_is_said_again_as_a_substitute(tmp_path: Path, processes: Processes) -> None:
    url, elsewhere = free_multicast_url(), free_multicast_url()
    config, file = fleet(tmp_path, url), tmp_path / "line.rec"
    said = await recorded(config, url, file, processes)
    header, records = read_recording(file)
    assert header.connections[0].url == url
    assert {record.key for record in records} == {""}
    listening = Listening(None)
    await listening.start(elsewhere)
    assert listening.transport is not None
    try:
        child = processes.start(
            *command("pubsub", "replay", str(file), "--to", elsewhere, "--speed", "10", "--json"),
            env=clean_environment(),
        )
        figures = await asyncio.to_thread(ended, child)
    finally:
        await listening.transport.close()
    assert figures["sources"] == {"ua_2_2_1001": "ua_65535_2_1001"}
    assert figures["commands_left_out"] == len(said)
    good = [event for event in listening.values if event.message.status == StatusCode.UNCERTAIN_SUBSTITUTE_VALUE]
    assert {event.topic for event in listening.values} == {Topic(65_535, 2, 1001)}
    assert [event.message.values[0] for event in good] == said[-len(good) :]
    assert len(good) > 30
    assert listening.values[-1].message.status == StatusCode.BAD_NO_COMMUNICATION
    assert "ActionReceived" not in listening.kinds


async def test_only_what_is_asked_for_is_said_again(tmp_path: Path, processes: Processes) -> None:
    url, elsewhere = free_multicast_url(), free_multicast_url()
    config, file = fleet(tmp_path, url), tmp_path / "line.rec"
    said = await recorded(config, url, file, processes, (TOPIC, OTHER))
    listening = Listening(None)
    await listening.start(elsewhere)
    assert listening.transport is not None

    async def replayed(*patterns: str) -> dict[str, Any]:
        only = [word for pattern in patterns for word in ("--only", pattern)]
        child = processes.start(
            *command("pubsub", "replay", str(file), "--to", elsewhere, "--speed", "50", "--json", *only),
            env=clean_environment(),
        )
        return await asyncio.to_thread(ended, child)

    try:
        one = await replayed("ua_2_2_20*")
        assert one["sources"] == {"ua_2_2_2001": "ua_65535_2_2001"}
        assert 30 < one["values"] <= len(said)
        assert {event.topic for event in listening.values} == {Topic(65_535, 2, OTHER.id)}
        both = await replayed("ua_2_2_1001", "*_2001")
        assert set(both["sources"]) == {"ua_2_2_1001", "ua_2_2_2001"}
        assert both["values"] == 2 * one["values"]
        assert {event.topic.id for event in listening.values} == {TOPIC.id, OTHER.id}
        none = await replayed("ua_2_2_1")
        assert (none["values"], none["sources"]) == (0, {})
        assert none["datagrams"] == both["datagrams"]
    finally:
        await listening.transport.close()


async def test_a_secured_recording_needs_its_keys(tmp_path: Path, processes: Processes) -> None:
    url = free_multicast_url()
    config, file = fleet(tmp_path, url, "sign_and_encrypt"), tmp_path / "line.rec"
    said = await recorded(config, url, file, processes)
    assert {record.key for record in read_recording(file)[1]} <= {"t-2/1", "c-2/1", ""}
    alone = processes.start(
        *command("pubsub", "export", str(file), str(tmp_path / "closed.mcap"), "--json"),
        env=clean_environment(UA_FLEET_CONFIG=str(tmp_path / "no.yaml")),
    )
    closed = await asyncio.to_thread(ended, alone)
    assert closed["values"] == 0
    assert closed["secured"] > 0
    listening = Listening(await keyed(config, 0, "t-65535"))
    await listening.start(url)
    assert listening.transport is not None
    try:
        child = processes.start(
            *command("pubsub", "replay", str(file), "-c", str(config), "--speed", "10", "--json"),
            env=clean_environment(),
        )
        figures = await asyncio.to_thread(ended, child)
    finally:
        await listening.transport.close()
    assert figures["values"] > 30
    good = [event for event in listening.values if event.message.status == StatusCode.UNCERTAIN_SUBSTITUTE_VALUE]
    assert [event.message.values[0] for event in good] == said[-len(good) :]
    assert len(good) > 30


async def test_exports_are_read_by_other_programs(tmp_path: Path, processes: Processes) -> None:
    url = free_multicast_url()
    config, file = fleet(tmp_path, url), tmp_path / "line.rec"
    said = await recorded(config, url, file, processes)
    for name in ("line.mcap", "line.pcapng"):
        child = processes.start(
            *command("pubsub", "export", str(file), str(tmp_path / name), "-c", str(config), "--json"),
            env=clean_environment(),
        )
        await asyncio.to_thread(ended, child)
    with (tmp_path / "line.mcap").open("rb") as opened:
        messages = [json.loads(message.data) for _, _, message in make_reader(opened).iter_messages()]
    levels = [message["fields"]["level"] for message in messages]
    assert levels == said[-len(levels) :]
    assert len(levels) > 30
    with (tmp_path / "line.pcapng").open("rb") as opened:
        packets = [content for _, content in dpkt.pcapng.Reader(opened)]
    assert [bytes(dpkt.ip.IP(packet).data.data) for packet in packets] == [
        record.datagram for record in read_recording(file)[1]
    ]


def test_it_ends_by_its_bounds(tmp_path: Path, processes: Processes) -> None:
    url = free_multicast_url()
    config = fleet(tmp_path, url)
    child = processes.start(
        *command("pubsub", "record", str(tmp_path / "a.rec"), "-c", str(config), "--timeout", "0.5", "--json"),
        env=clean_environment(),
    )
    assert ended(child)["datagrams"] == 0
    again = processes.start(
        *command("pubsub", "record", str(tmp_path / "a.rec"), "-c", str(config)), env=clean_environment()
    )
    again.process.wait(60)
    assert again.end() == 1
    assert any("exists already; name another file" in line for line in again.lines)


def test_a_replay_is_no_bridge_s(tmp_path: Path, processes: Processes) -> None:
    config = tmp_path / "fleet.yaml"
    config.write_text(
        "version: 1\npubsub: {security: none}\nbridges:\n"
        "  plc: {kind: modbus, space: 300, status_id: 1900, devices: {d: {host: h}}}\n"
    )
    child = processes.start(
        *command("pubsub", "replay", str(tmp_path / "a.rec"), "-c", str(config), "--space", "300"),
        env=clean_environment(),
    )
    child.process.wait(60)
    assert child.end() == 2
    assert any("space 300 is that of bridge plc" in line for line in child.lines)
