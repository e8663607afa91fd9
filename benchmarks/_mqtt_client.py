"""One MQTT client library at work, in a process of its own: `python _mqtt_client.py LIBRARY SCENARIO PORT COUNT`.

    publish   COUNT messages of 100 bytes at QoS 1, at most 500 in flight, until all are acknowledged
    receive   hears COUNT messages of QoS 1 that another process sends once this one says `ready`
    stalled   hands over messages of 1 kB at QoS 1 as long as the library takes them, at most COUNT and 5 s, while the
              broker reads nothing

Prints one line of JSON. Nothing of the project is imported, so that it runs in an environment with the libraries alone.
"""

from __future__ import annotations

import asyncio
import json
import os
import resource
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from importlib import import_module
from typing import Any

IN_FLIGHT = 500
PAYLOAD = b"x" * 100
LARGE = b"x" * 1000
STALL_S = 5.0
TOPIC = "bench/value"


def memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


class Measured:
    """Counts acknowledgements, and tells time, processor time and memory."""

    def __init__(self, count: int) -> None:
        self.count, self.done = count, 0
        self.memory, self.cpu, self.start = memory_mb(), time.process_time(), time.perf_counter()

    def result(self, **more: Any) -> dict[str, Any]:
        seconds = time.perf_counter() - self.start
        return {
            "done": self.done,
            "per_second": self.done / seconds,
            "cpu_us": (time.process_time() - self.cpu) / max(self.done, 1) * 1e6,
            "memory_mb": memory_mb() - self.memory,
            "seconds": seconds,
            **more,
        }


async def by_tasks(publish: Any, measured: Measured) -> None:
    """For libraries that are awaited for each acknowledgement: as many tasks as may be in flight."""
    left = iter(range(measured.count))

    async def work() -> None:
        for _ in left:
            await publish()
            measured.done += 1

    await asyncio.gather(*(work() for _ in range(IN_FLIGHT)))


class Flying:
    """For libraries that call back for each acknowledgement: so many messages as may be in flight."""

    def __init__(self, measured: Measured) -> None:
        self._measured, self._count, self._room = measured, 0, asyncio.Event()

    def landed(self, *_arguments: Any) -> None:
        """A message was acknowledged."""
        self._count -= 1
        self._measured.done += 1
        self._room.set()

    async def all(self, send: Callable[[], object]) -> dict[str, Any]:
        """Send all messages and wait until they are acknowledged."""
        for _ in range(self._measured.count):
            await self._fewer_than(IN_FLIGHT)
            self._count += 1
            send()
        await self._fewer_than(1)
        return self._measured.result()

    async def _fewer_than(self, most: int) -> None:
        while self._count >= most:
            self._room.clear()
            await self._room.wait()


async def stalled_tasks(publish: Any, count: int) -> dict[str, Any]:
    """How many calls are taken while nothing is acknowledged, where each waits for its acknowledgement."""
    measured = Measured(count)
    tasks: list[asyncio.Future[Any]] = []
    for number in range(count):
        tasks.append(asyncio.ensure_future(publish()))
        measured.done += 1
        if number % 100 == 0:
            await asyncio.sleep(0)
        if time.perf_counter() - measured.start > STALL_S:
            break
    await asyncio.sleep(0.2)
    waiting = sum(not task.done() for task in tasks)
    result = measured.result(refused="", waiting=waiting)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    return result


async def mqttium_(scenario: str, port: int, count: int) -> dict[str, Any]:
    mqttium: Any = import_module("mqttium")
    api: Any = import_module("mqttium.api")
    received = asyncio.Event()
    client = api.AsyncClient(
        f"bench-{scenario}",
        protocol=mqttium.MQTTProtocolVersion.MQTTv5,
        max_outbound_inflight=IN_FLIGHT,
        max_unacknowledged_messages=2 * IN_FLIGHT,
        max_unacknowledged_bytes=4 * 1024 * 1024,
        message_delivery="callback",
    )
    measured = Measured(count)

    def on_message(_message: Any) -> None:
        measured.done += 1
        if measured.done == count:
            received.set()

    client.on_message = on_message
    await client.connect("127.0.0.1", port)
    if scenario == "receive":
        await client.subscribe(TOPIC, qos=1)
        print("ready", flush=True)
        await received.wait()
        return measured.result()
    if scenario == "stalled":
        refused = ""
        for _ in range(count):
            try:
                client.publish_nowait(TOPIC, LARGE, qos=1)
            except mqttium.FlowControlError as error:
                refused = type(error).__name__
                break
            measured.done += 1
            await asyncio.sleep(0)
        return measured.result(refused=refused)
    flying = Flying(Measured(count))
    return await flying.all(lambda: client.publish_nowait(TOPIC, PAYLOAD, qos=1).add_done_callback(flying.landed))


async def gmqtt_(scenario: str, port: int, count: int) -> dict[str, Any]:
    gmqtt: Any = import_module("gmqtt")
    received = asyncio.Event()
    client = gmqtt.Client(f"bench-{scenario}")
    measured = Measured(count)

    def on_message(*_arguments: Any) -> int:
        measured.done += 1
        if measured.done == count:
            received.set()
        return 0

    client.on_message = on_message
    await client.connect("127.0.0.1", port)
    storage: Any = getattr(client, "_persistent_storage")  # noqa: B009 - it has no other way
    if scenario == "receive":
        subscribed = asyncio.Event()

        def on_subscribe(*_arguments: Any) -> None:
            subscribed.set()

        client.on_subscribe = on_subscribe
        client.subscribe(TOPIC, qos=1)
        await subscribed.wait()
        print("ready", flush=True)
        await received.wait()
        return measured.result()
    if scenario == "stalled":
        for _ in range(count):
            client.publish(gmqtt.Message(TOPIC, LARGE, qos=1))
            measured.done += 1
            await asyncio.sleep(0)
            if time.perf_counter() - measured.start > STALL_S:
                break
        return measured.result(refused="")
    # It tells nobody of an acknowledgement; its store of unacknowledged messages is the only place to look.
    removed: Any = storage.remove_message_by_mid
    flying = Flying(Measured(count))

    def remove(mid: int) -> None:
        removed(mid)
        flying.landed()

    storage.remove_message_by_mid = remove
    return await flying.all(lambda: client.publish(gmqtt.Message(TOPIC, PAYLOAD, qos=1)))


async def zmqtt_(scenario: str, port: int, count: int) -> dict[str, Any]:
    zmqtt: Any = import_module("zmqtt")
    at_least_once = zmqtt.QoS.AT_LEAST_ONCE
    async with zmqtt.create_client("127.0.0.1", port, client_id=f"bench-{scenario}", version="5.0") as client:
        if scenario == "receive":
            async with client.subscribe(TOPIC, qos=at_least_once) as messages:
                print("ready", flush=True)
                measured = Measured(count)
                async for _ in messages:
                    measured.done += 1
                    if measured.done == count:
                        return measured.result()
        if scenario == "stalled":
            return await stalled_tasks(lambda: client.publish(TOPIC, LARGE, qos=at_least_once), count)
        measured = Measured(count)
        await by_tasks(lambda: client.publish(TOPIC, PAYLOAD, qos=at_least_once), measured)
        return measured.result()


async def aiomqtt_(scenario: str, port: int, count: int) -> dict[str, Any]:
    aiomqtt: Any = import_module("aiomqtt")
    many = 1_000_000
    async with aiomqtt.Client(
        "127.0.0.1",
        port,
        identifier=f"bench-{scenario}",
        protocol=aiomqtt.ProtocolVersion.V5,
        max_inflight_messages=IN_FLIGHT,
        max_concurrent_outgoing_calls=many,
    ) as client:
        if scenario == "receive":
            await client.subscribe(TOPIC, qos=1)
            print("ready", flush=True)
            measured = Measured(count)
            async for _ in client.messages:
                measured.done += 1
                if measured.done == count:
                    return measured.result()
        if scenario == "stalled":
            return await stalled_tasks(lambda: client.publish(TOPIC, LARGE, qos=1, timeout=60), count)
        measured = Measured(count)
        await by_tasks(lambda: client.publish(TOPIC, PAYLOAD, qos=1, timeout=60), measured)
        return measured.result()


async def awscrt_(scenario: str, port: int, count: int) -> dict[str, Any]:
    mqtt5: Any = import_module("awscrt.mqtt5")
    connected, received = threading.Event(), threading.Event()
    measured = Measured(count)

    def on_connected(_data: Any) -> None:
        connected.set()

    def on_publish(_data: Any) -> None:
        measured.done += 1
        if measured.done == count:
            received.set()

    client = mqtt5.Client(
        mqtt5.ClientOptions(
            host_name="127.0.0.1",
            port=port,
            connect_options=mqtt5.ConnectPacket(client_id=f"bench-{scenario}"),
            on_lifecycle_event_connection_success_fn=on_connected,
            on_publish_callback_fn=on_publish,
        )
    )
    client.start()
    await asyncio.to_thread(connected.wait, 10)
    loop = asyncio.get_running_loop()
    if scenario == "receive":
        wanted = mqtt5.SubscribePacket(
            subscriptions=[mqtt5.Subscription(topic_filter=TOPIC, qos=mqtt5.QoS.AT_LEAST_ONCE)]
        )
        await asyncio.wrap_future(client.subscribe(wanted))
        print("ready", flush=True)
        await asyncio.to_thread(received.wait, 60)
        return measured.result()
    if scenario == "stalled":
        for _ in range(count):
            client.publish(mqtt5.PublishPacket(topic=TOPIC, payload=LARGE, qos=mqtt5.QoS.AT_LEAST_ONCE))
            measured.done += 1
            if time.perf_counter() - measured.start > STALL_S:
                break
        await asyncio.sleep(0.2)
        return measured.result(refused="")
    flying = Flying(Measured(count))

    def acknowledged(_future: Any) -> None:
        loop.call_soon_threadsafe(flying.landed)

    def send() -> None:
        future = client.publish(mqtt5.PublishPacket(topic=TOPIC, payload=PAYLOAD, qos=mqtt5.QoS.AT_LEAST_ONCE))
        future.add_done_callback(acknowledged)

    return await flying.all(send)


async def pymosquitto_(scenario: str, port: int, count: int) -> dict[str, Any]:
    """On the event loop, as a transport of ours would use it."""
    aio: Any = import_module("pymosquitto.aio")
    async with aio.TrueAsyncMosquitto(f"bench-{scenario}") as client:
        await client.connect("127.0.0.1", port)
        if scenario == "receive":
            await client.subscribe(TOPIC, qos=1)
            print("ready", flush=True)
            measured = Measured(count)
            async for _ in client.read_messages():
                measured.done += 1
                if measured.done == count:
                    return measured.result()
        if scenario == "stalled":
            return await stalled_tasks(lambda: client.publish(TOPIC, LARGE, qos=1), count)
        measured = Measured(count)
        await by_tasks(lambda: client.publish(TOPIC, PAYLOAD, qos=1), measured)
        return measured.result()


async def socket_(scenario: str, port: int, count: int) -> dict[str, Any]:
    """No library: packets that were made before, written by the event loop, and acknowledgements counted."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    identifier = f"bench-{scenario}".encode()
    body = b"\x00\x04MQTT\x04\x02\x00\x3c" + struct.pack(">H", len(identifier)) + identifier
    writer.write(bytes((0x10, len(body))) + body)
    await reader.readexactly(4)
    topic = struct.pack(">H", len(TOPIC)) + TOPIC.encode()
    length = len(topic) + 2 + len(PAYLOAD)
    writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if scenario == "receive":
        writer.write(b"\x82" + bytes((len(topic) + 3,)) + b"\x00\x01" + topic + b"\x01")
        await reader.readexactly(5)
        print("ready", flush=True)
        measured = Measured(count)
        size = 2 + length
        while measured.done < count:
            packet = await reader.readexactly(size)
            at = 2 + len(topic)
            writer.write(b"\x40\x02" + packet[at : at + 2])
            measured.done += 1
        await writer.drain()
        return measured.result()
    measured = Measured(count)
    sent = 0
    pending = b""
    while measured.done < count:
        while sent < count and sent - measured.done < IN_FLIGHT:
            writer.write(bytes((0x32, length)) + topic + struct.pack(">H", sent % 65_535 + 1) + PAYLOAD)
            sent += 1
        pending += await reader.read(65_536)
        measured.done += len(pending) // 4
        pending = pending[len(pending) // 4 * 4 :]
    return measured.result()


LIBRARIES = {
    "mqttium": mqttium_,
    "gmqtt": gmqtt_,
    "zmqtt": zmqtt_,
    "aiomqtt": aiomqtt_,
    "awscrt": awscrt_,
    "pymosquitto": pymosquitto_,
    "socket": socket_,
}


if __name__ == "__main__":
    library, scenario, port, count = sys.argv[1:]

    async def main() -> None:
        print(json.dumps(await LIBRARIES[library](scenario, int(port), int(count))), flush=True)
        os._exit(0)  # a library that waits for a broker which does not answer is not waited for

    asyncio.run(main())
