"""Who sends values over MQTT, in a process of its own; what it is told stands at each class.

    python -m benchmarks._mqtt_sender library|socket URL SOURCES | bridges COUNT URL... | robot FLEET_JSON | bare URL

Prints `ready`, and `done` with figures of its own for each line on its standard input.
"""

from __future__ import annotations

import asyncio
import json
import socket
import struct
import sys
import time
from collections import deque
from pathlib import Path
from typing import Any

import structlog
from mqttium import MQTTProtocolVersion
from mqttium.api import AsyncClient

from benchmarks._mqtt_fleet import FIRST_SPACE, SimulatedBridge, source, wall_ticks
from ua_fleet.bridge import Driver, DriverStatus, Inlet, SampleRead, SourceFound
from ua_fleet.bridge.runner import run_bridge
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.transports import open_transport
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.address import BrokerAddress, parse_broker_url
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

IN_FLIGHT = 500
STEP_S = 0.002
TOPIC = "benchmark"
Message = tuple[str, bytes]
"""Topic and payload."""


async def _line() -> list[str]:
    line: str = await asyncio.to_thread(sys.stdin.readline)
    return line.split()


def _done(**figures: Any) -> None:
    print("done", json.dumps(figures), flush=True)


class Flood:
    """`COUNT RATE`: so many messages in turn of all sources, at once or at a rate; they are made before.

    They are those that a bridge sends. What sends them is the library of `transport.mqtt`, or a bare socket with whole
    packets, which takes the least of the processors.
    """

    def __init__(self, url: str, sources: int, *, has_library: bool) -> None:
        self._address, self._url, self._has_library = parse_broker_url(url), url, has_library
        self._topics = [source(number, 1) for number in range(sources)]
        self._sent = 0
        self._ticks = wall_ticks()

    async def run(self) -> None:
        self._bridge = SimulatedBridge(FIRST_SPACE, self._topics, self._url)
        await self._bridge.start()
        await asyncio.sleep(0.5)
        await self._bridge.transport.close()  # what it has said of the sources is retained
        sender = await (LibrarySender if self._has_library else SocketSender).open(self._address)
        print("ready", flush=True)
        while words := await _line():
            count, rate = int(words[0]), float(words[1])
            messages = self._messages(count)
            began, cpu_s = time.monotonic(), time.process_time()
            await sender.send(messages, rate)
            _done(began=began, seconds=time.monotonic() - began, cpu_s=time.process_time() - cpu_s)

    def _messages(self, count: int) -> deque[Message]:
        messages: deque[Message] = deque()
        self._ticks = max(self._ticks + 10, wall_ticks())
        for index in range(count):
            topic = self._topics[self._sent % len(self._topics)]
            self._sent += 1
            (payload,) = self._bridge.made(topic, float(self._sent), self._ticks + index)
            messages.append((topic.name, payload))
        self._ticks += count
        return messages


def _due(began: float, rate: float, count: int) -> int:
    """How many of so many messages are due; all without a rate."""
    return min(count, int((time.monotonic() - began) * rate) + 1) if rate else count


class LibrarySender:
    """Sends with MQTT 5 and the library."""

    def __init__(self, client: AsyncClient) -> None:
        self._client = client
        self._flying = 0
        self._landed = asyncio.Event()

    @classmethod
    async def open(cls, address: BrokerAddress) -> LibrarySender:
        client = AsyncClient("flood", protocol=MQTTProtocolVersion.MQTTv5, max_unacknowledged_messages=2 * IN_FLIGHT)
        await client.connect(address.host, address.port)
        return cls(client)

    def _acknowledged(self, _receipt: object) -> None:
        self._flying -= 1
        self._landed.set()

    async def send(self, messages: deque[Message], rate: float) -> None:
        """At most IN_FLIGHT that the broker has not acknowledged, until it has all."""
        began, count = time.monotonic(), len(messages)
        while messages or self._flying:
            sent = count - len(messages)
            for _ in range(min(_due(began, rate, count) - sent, IN_FLIGHT - self._flying)):
                self._flying += 1
                topic, payload = messages.popleft()
                self._client.publish_nowait(topic, payload, qos=1).add_done_callback(self._acknowledged)
            if rate and messages:
                await asyncio.sleep(STEP_S)
            else:
                self._landed.clear()
                await self._landed.wait()


class SocketSender:
    """Sends whole packets of MQTT 3.1.1, which are made before."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer

    @classmethod
    async def open(cls, address: BrokerAddress) -> SocketSender:
        reader, writer = await asyncio.open_connection(address.host, address.port)
        body = b"\x00\x04MQTT\x04\x02\x00\x00" + struct.pack(">H", 5) + b"flood"
        writer.write(bytes((0x10, len(body))) + body)
        await reader.readexactly(4)
        writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return cls(reader, writer)

    async def send(self, messages: deque[Message], rate: float) -> None:
        """At most IN_FLIGHT that the broker has not acknowledged, until it has all."""
        packets = deque(_packet(number, *message) for number, message in enumerate(messages))
        began, count, acknowledged, pending = time.monotonic(), len(packets), 0, b""
        while acknowledged < count:
            sent = count - len(packets)
            due = min(_due(began, rate, count) - sent, IN_FLIGHT - sent + acknowledged)
            self._writer.write(b"".join(packets.popleft() for _ in range(due)))
            if count - len(packets) > acknowledged:
                pending += await self._reader.read(65_536)
                acknowledged += len(pending) // 4  # a PUBACK
                pending = pending[len(pending) // 4 * 4 :]
            if rate and packets:
                await asyncio.sleep(STEP_S)


def _packet(number: int, topic: str, payload: bytes) -> bytes:
    rest = struct.pack(">H", len(topic)) + topic.encode() + struct.pack(">H", number % 65_535 + 1) + payload
    assert len(rest) < 128, "the length is one byte"
    return bytes((0x32, len(rest))) + rest


async def bridges(count: int, *urls: str) -> None:
    """`SECONDS RATE`: so many bridges, at the nodes of a cluster in turn, with a source each; the rate of all.

    The values are numbers, from 1 on, each of which is sent once.
    """
    topics = [source(number, count) for number in range(count)]
    made = [
        SimulatedBridge(topic.space, [topic], *urls[number % len(urls) :], *urls[: number % len(urls)])
        for number, topic in enumerate(topics)
    ]
    for bridge in made:  # one after the other: a cluster that all come to at once is slow to let them in
        await bridge.start()
    print("ready", flush=True)
    number = 0
    while words := await _line():
        seconds, rate = float(words[0]), float(words[1])
        began, sent = time.monotonic(), 0
        while sent < seconds * rate:
            for _ in range(_due(began, rate, int(seconds * rate)) - sent):
                sent += 1
                number += 1
                bridge = made[number % count]
                bridge.publish(bridge.topics[0], float(number))
            await asyncio.sleep(STEP_S)
        _done(sent=sent, last=number)
    for bridge in made:
        await bridge.transport.close()


class ClockDriver(Driver):
    """Its robot has one value, the monotonic clock, which a thread tells as that of a robot library would."""

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._inlet: Inlet | None = None

    async def start(self, inlet: Inlet) -> None:
        self._inlet = inlet
        inlet.put(SourceFound(self._topic, self._topic.name, (make_field("data", BuiltinType.DOUBLE),)))

    def tell(self, count: int, rate: float) -> None:
        """Tell so many values, so often."""
        assert self._inlet is not None
        for _ in range(count):
            self._inlet.put(SampleRead(self._topic, (time.monotonic(),), time.time_ns()))
            time.sleep(1 / rate)

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        return True

    def status(self) -> DriverStatus:
        return DriverStatus(self._inlet is not None, "a clock")

    async def stop(self) -> None:
        self._inlet = None


async def robot(config: FleetConfig, folder: Path) -> None:
    """`COUNT RATE`: so many values at a rate of the robot of a real bridge, from its driver's thread on."""
    name = "hall0"
    driver, ready = ClockDriver(source(0, 1)), asyncio.Event()
    transport = open_transport(config, folder, space=config.bridges[name].space, hears_itself=False)
    running = asyncio.ensure_future(
        run_bridge(config, name, driver, transport, state_dir=folder / name, ready=ready.set)
    )
    await ready.wait()
    print("ready", flush=True)
    while words := await _line():
        await asyncio.to_thread(driver.tell, int(words[0]), float(words[1]))
        _done()
    running.cancel()
    await asyncio.wait([running])


async def bare(url: str) -> None:
    """`COUNT RATE`: the same with the client library alone: eight bytes, the monotonic clock."""
    address = parse_broker_url(url)
    client = AsyncClient("bare-sender", protocol=MQTTProtocolVersion.MQTTv5)
    await client.connect(address.host, address.port)
    print("ready", flush=True)
    while words := await _line():
        for _ in range(int(words[0])):
            client.publish_nowait(TOPIC, struct.pack("<d", time.monotonic()), qos=1)
            await asyncio.sleep(1 / float(words[1]))
        _done()
    await client.disconnect()


def main() -> None:
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    match sys.argv[1:]:
        case [("library" | "socket") as role, url, sources]:
            asyncio.run(Flood(url, int(sources), has_library=role == "library").run())
        case ["bridges", count, *urls]:
            asyncio.run(bridges(int(count), *urls))
        case ["robot", path]:
            content = Path(path).read_text(encoding="utf-8")
            asyncio.run(robot(FleetConfig.model_validate_json(content), Path(path).parent))
        case ["bare", url]:
            asyncio.run(bare(url))
        case words:
            sys.exit(f"no such role: {words}")


if __name__ == "__main__":
    main()
