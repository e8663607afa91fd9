"""A datagram from a real UDP socket to a Subscriber, verified, decrypted and decoded, beside asyncua without security.

Ours is everything that a bridge or the server does with a datagram before its values are used: read from the socket,
message security with AES-256 and a strict replay window, the codec, and all gates of the Subscriber, which hands on one
DataReceived. asyncua gets the same message unsecured, and less is asked of it: its own asyncio protocol reads and
decodes it, and hands it to a receiver that only counts. Shown beside it is its decoder alone, fed by our transport.

CPU time of the receiving thread, the kernel's part included. The datagrams wait in the socket's buffer before the time
begins, so sending is not in it.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import socket
import time
from collections.abc import Callable, Coroutine
from typing import Any, Final

import structlog
from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.pubsub import uadp
from asyncua.pubsub.udp import OpcUdp, UdpSettings

from benchmarks.codec import LAYOUTS, NOON
from benchmarks.harness import Figure, at_most, interleaved, shown
from ua_fleet.counters import Counters
from ua_fleet.pubsub import DataReceived, Publisher, PubSubTiming, Subscriber, make_field
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.topics import Topic
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.wire import Codec, SecurityMode, SecurityPolicy

GOAL: Final = 0.2
LAYOUT: Final = "1x10 mixed"
BATCH: Final = 100
"""Datagrams that every receive buffer holds."""
BATCHES: Final = 10
ROUNDS: Final = 3
SPACE: Final = 2
TOPIC: Final = Topic(SPACE, 2, 1001)
POLICY: Final = SecurityPolicy.AES256_CTR


class _Robot:
    """Publishes messages of the layout, each with a later Timestamp; plain ones, to be sealed or not."""

    def __init__(self, codec: Codec) -> None:
        types, self._make = LAYOUTS[LAYOUT]
        self.publisher = Publisher(SPACE, PubSubTiming(), Counters(), codec)
        fields = tuple(
            make_field(f"f{index}", code & 0x3F, array=bool(code & ~0x3F)) for index, code in enumerate(types)
        )
        self.announcement = self.publisher.announce(TOPIC, "robot", fields, now=0.0, wall_ticks=NOON)
        self._number = 0

    def batch(self) -> list[bytes]:
        datagrams: list[bytes] = []
        for _ in range(BATCH):
            self._number += 1
            values = self._make(self._number)
            datagrams += self.publisher.publish(TOPIC, values, timestamp=NOON + 10 * self._number, now=0.0)
        return datagrams


class _Reader:
    """A Subscriber with or without security, and its counterpart that seals."""

    def __init__(self, mode: SecurityMode) -> None:
        codec = Codec()
        self.robot = _Robot(codec)
        self.counters = Counters()
        self._sealing = Envelope(SPACE, Counters(), mode=mode, nonces=MemoryNonces())
        opening = Envelope(0, self.counters, mode=mode, nonces=MemoryNonces())
        keys = GroupKeys(POLICY, 1, (secrets.token_bytes(POLICY.key_data_bytes),), 1e9, 1e9)
        if mode is not SecurityMode.NONE:
            for envelope in (self._sealing, opening):
                envelope.install(f"t-{SPACE}", keys, 0.0)
        self.subscriber = Subscriber(0, PubSubTiming(), self.counters, Codec(), envelope=opening)
        self.handed_on = 0
        for datagram in self._sealed(self.robot.announcement):
            self.subscriber.receive(datagram, 0.0)

    def batch(self) -> list[bytes]:
        return self._sealed(self.robot.batch())

    def receive(self, datagram: bytes) -> None:
        for event in self.subscriber.receive(datagram, 0.0):
            assert type(event) is DataReceived
            self.handed_on += 1

    def _sealed(self, datagrams: list[bytes]) -> list[bytes]:
        return [sealed for datagram in datagrams for sealed in self._sealing.seal(datagram, 0.0)]


class _Counting:
    """What asyncua's protocol hands messages to."""

    def __init__(self, taken: Callable[[], None]) -> None:
        self._taken = taken

    async def got_uadp(self, msg: uadp.UadpNetworkMessage) -> None:
        del msg
        self._taken()


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


async def _cpu_s(port: int, batches: list[list[bytes]], is_done: asyncio.Event) -> float:
    """CPU seconds for one datagram, from its place in the socket's buffer on; `is_done` is set after each batch."""
    spent = 0.0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for batch in batches:
            for datagram in batch:
                sender.sendto(datagram, ("127.0.0.1", port))
            started = time.thread_time()
            async with asyncio.timeout(10):
                await is_done.wait()
            spent += time.thread_time() - started
            is_done.clear()
    return spent / (len(batches) * BATCH)


class _Countdown:
    """Sets the event when a batch has been taken."""

    def __init__(self) -> None:
        self.is_done = asyncio.Event()
        self._left = BATCH

    def take(self) -> None:
        self._left -= 1
        if not self._left:
            self._left = BATCH
            self.is_done.set()


async def _through_our_transport(handle: Callable[[bytes], object], batches: list[list[bytes]]) -> float:
    countdown, port = _Countdown(), _free_port()

    def receive(datagram: bytes, _sender: tuple[str, int]) -> None:
        handle(datagram)
        countdown.take()

    transport = UdpTransport(f"opc.udp://127.0.0.1:{port}", "lo")
    await transport.start(receive)
    try:
        return await _cpu_s(port, batches, countdown.is_done)
    finally:
        await transport.close()


async def _through_asyncuas_protocol(batches: list[list[bytes]]) -> float:
    countdown, port = _Countdown(), _free_port()
    settings = UdpSettings(Addr=("127.0.0.1", port))
    protocol = OpcUdp(settings, _Counting(countdown.take), ua.Variant(ua.UInt16(1)))
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: protocol, local_addr=("127.0.0.1", port)
    )
    try:
        return await _cpu_s(port, batches, countdown.is_done)
    finally:
        transport.close()


def _asyncua_decode(datagram: bytes) -> Any:
    return uadp.UadpNetworkMessage.from_binary(Buffer(datagram))


def figures(rounds: int) -> list[Figure]:
    logging.getLogger("asyncua").setLevel(logging.WARNING)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    readers = {mode: _Reader(mode) for mode in SecurityMode}
    plain = readers[SecurityMode.NONE].robot
    with asyncio.Runner() as runner:

        def run(coroutine: Coroutine[Any, Any, float]) -> float:
            return runner.run(coroutine)

        def ours(mode: SecurityMode) -> float:
            reader = readers[mode]
            before = reader.handed_on
            batches = [reader.batch() for _ in range(BATCHES)]
            spent = run(_through_our_transport(reader.receive, batches))
            assert reader.handed_on - before == BATCHES * BATCH
            assert not reader.counters.drops
            return spent

        def theirs(through: Callable[[list[list[bytes]]], Coroutine[Any, Any, float]]) -> float:
            return run(through([plain.batch() for _ in range(BATCHES)]))

        none, sign, encrypt, decoding, protocol = interleaved(
            ROUNDS * rounds,
            [
                lambda: ours(SecurityMode.NONE),
                lambda: ours(SecurityMode.SIGN),
                lambda: ours(SecurityMode.SIGN_AND_ENCRYPT),
                lambda: theirs(lambda batches: _through_our_transport(_asyncua_decode, batches)),
                lambda: theirs(_through_asyncuas_protocol),
            ],
        )
    peer = "asyncua 2.1.0, unsecured"
    rows = [
        at_most(f"CPU {LAYOUT}, {name}", value * 1e6, "us", reference=peer, reference_value=protocol * 1e6, goal=GOAL)
        for name, value in (("SignAndEncrypt", encrypt), ("Sign", sign), ("None", none))
    ]
    decoder = "asyncua 2.1.0, unsecured, its decoder alone"
    name = f"CPU {LAYOUT}, SignAndEncrypt, beside a decoder"
    return [*rows, shown(name, encrypt * 1e6, "us", reference=decoder, reference_value=decoding * 1e6)]
