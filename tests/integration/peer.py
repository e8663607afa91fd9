"""The other side of a bridge, in the test's process: hears its PubSub side, and publishes as another space."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final, Self

from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import envelope_of, groups_of
from ua_fleet.counters import Counters
from ua_fleet.keys.keeper import KeysKept, keep_keys
from ua_fleet.keys.source import KeySource
from ua_fleet.pubsub.events import (
    DataReceived,
    ProbeReceived,
    SourceReturned,
    SourceSilent,
    SourceStale,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import Topic
from ua_fleet.transport.base import Transport
from ua_fleet.transport.mqtt.address import is_broker_url
from ua_fleet.transport.mqtt.topics import TopicTree
from ua_fleet.transport.mqtt.transport import MqttTransport
from ua_fleet.transport.party import tool_party
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.values import ticks_from_unix_ns
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import DataSetMessage, FieldMetaData

TIMING: Final = PubSubTiming(1.0, 3.0, 5.0)


class Peer:
    """All that comes over a multicast group or a broker, seen from one space."""

    def __init__(
        self,
        url: str,
        space: int = 0,
        envelope: Callable[[Counters], Envelope] | None = None,
        timing: PubSubTiming = TIMING,
    ) -> None:
        self.counters = Counters()
        self.events: list[SubscriberEvent] = []
        self.datagrams: list[bytes] = []
        """All that came over the network, as it came."""
        self._envelope = envelope(self.counters) if envelope is not None else None
        self._transport: Transport
        if is_broker_url(url):
            brokered = self._transport = MqttTransport(url, TopicTree())
            brokered.speak_for(tool_party(self._receive_kept))
        else:
            self._transport = UdpTransport(url, "lo", ttl=1, receive_buffer_bytes=1 << 22)
        codec = Codec()
        self._publisher = Publisher(space, timing, self.counters, codec)
        self._subscriber = Subscriber(space, timing, self.counters, codec, envelope=self._envelope)
        self._changed = asyncio.Event()
        self._is_mute = False

    def _now(self) -> float:
        return asyncio.get_running_loop().time()

    def _receive(self, datagram: bytes, _sender: Any) -> None:
        self.datagrams.append(datagram)
        self._take(self._subscriber.receive(datagram, self._now()))

    def _receive_kept(self, datagram: bytes, _sender: Any) -> None:
        self._take(self._subscriber.receive(datagram, self._now(), is_fresh=False))

    def _take(self, events: list[SubscriberEvent]) -> None:
        for event in events:
            if isinstance(event, SourceUnknown):
                if event.datagram is not None:
                    self._send([event.datagram])
            elif isinstance(event, ProbeReceived):
                self._send(self._publisher.answer(event.probe, self._now()))
        self.events += events
        self._changed.set()

    def _send(self, datagrams: list[bytes]) -> None:
        for datagram in datagrams:
            for sealed in [datagram] if self._envelope is None else self._envelope.seal(datagram, self._now()):
                self.send(sealed)

    def send(self, datagram: bytes) -> None:
        """Send any bytes, unless mute."""
        if not self._is_mute:
            self._transport.send(datagram)

    def mute(self) -> None:
        """Send nothing more, like a process that was killed."""
        self._is_mute = True

    def unmute(self) -> None:
        """Go on."""
        self._is_mute = False

    def lose(self, topic: Topic) -> None:
        """Say that a source is gone."""
        ticks = ticks_from_unix_ns(time.time_ns())
        self._send(self._publisher.source_lost(topic, timestamp=ticks, now=self._now()))

    async def _tick(self) -> None:
        while True:
            self._send(self._publisher.poll(self._now()))
            self._take(self._subscriber.poll(self._now()))
            await asyncio.sleep(0.02)

    def announce(self, topic: Topic, fields: tuple[FieldMetaData, ...]) -> None:
        ticks = ticks_from_unix_ns(time.time_ns())
        self._send(self._publisher.announce(topic, topic.name, fields, now=self._now(), wall_ticks=ticks))

    def publish(self, topic: Topic, *values: Any) -> None:
        ticks = ticks_from_unix_ns(time.time_ns())
        self._send(self._publisher.publish(topic, values, timestamp=ticks, now=self._now()))

    def messages(self, topic: Topic) -> list[DataSetMessage]:
        """All that was received of a source, in order, those with a Bad status too."""
        return [e.message for e in self.events if isinstance(e, DataReceived) and e.topic == topic]

    def good(self, topic: Topic) -> list[tuple[Any, ...]]:
        """The values of all good messages of a source."""
        return [message.values for message in self.messages(topic) if not message.status]

    def properties(self, topic: Topic) -> dict[str, Any]:
        """The properties of a source's first field."""
        event = next(e for e in self.events if isinstance(e, DataReceived) and e.topic == topic)
        return {str(key.name): value for key, _, value in event.metadata.fields[0].properties}

    def is_silent(self, topic: Topic) -> bool:
        """Whether nothing comes from a source any more."""
        return self._last_said(topic) is SourceSilent

    def is_stale(self, topic: Topic) -> bool:
        """Whether a source is there, and nothing says that its last value is of now."""
        return self._last_said(topic) is SourceStale

    def _last_said(self, topic: Topic) -> type | None:
        for event in reversed(self.events):
            if isinstance(event, SourceSilent | SourceStale | SourceReturned) and event.topic == topic:
                return type(event)
        return None

    async def until(self, condition: Callable[[], Any], timeout_s: float = 60) -> None:
        """Wait until a condition on what was received holds."""
        async with asyncio.timeout(timeout_s):
            while not condition():
                self._changed.clear()
                try:
                    async with asyncio.timeout(0.1):
                        await self._changed.wait()
                except TimeoutError:
                    continue

    async def status(self, topic: Topic) -> dict[str, Any]:
        """The status of a bridge from now on, by field name; the next one to come may be a repeat of an older one."""
        seen = len(self.messages(topic))
        await self.until(lambda: len(self.messages(topic)) > seen + 1)
        event = [e for e in self.events if isinstance(e, DataReceived) and e.topic == topic][-1]
        return {field.name: value for field, value in zip(event.metadata.fields, event.message.values, strict=True)}

    @classmethod
    @asynccontextmanager
    async def at(cls, url: str, space: int = 0, timing: PubSubTiming = TIMING) -> AsyncGenerator[Self]:
        """A peer without keys that works while the context lasts."""
        peer = cls(url, space, timing=timing)
        async with peer._working():
            yield peer

    @classmethod
    @asynccontextmanager
    async def secured(cls, config: FleetConfig, space: int, folder: Path, source: KeySource) -> AsyncGenerator[Self]:
        """A peer with the keys of a space; it keeps its nonces in `folder`."""
        nonces = folder / f"nonces-{space}"
        peer = cls(config.pubsub.url, space, lambda counters: envelope_of(config, space, counters, nonces))
        assert peer._envelope is not None
        kept = KeysKept()
        keeping = asyncio.ensure_future(keep_keys(peer._envelope, source, kept, count=2))
        try:
            async with asyncio.timeout(60):
                await kept.wait_for(groups_of(config, space))
            async with peer._working():
                yield peer
        finally:
            keeping.cancel()
            await asyncio.wait([keeping])

    @asynccontextmanager
    async def _working(self) -> AsyncGenerator[None]:
        await self._transport.start(self._receive)
        ticking = asyncio.ensure_future(self._tick())
        try:
            yield
        finally:
            ticking.cancel()
            await asyncio.wait([ticking])
            await self._transport.close()
