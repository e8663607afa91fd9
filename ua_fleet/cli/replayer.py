"""`ua-fleet pubsub replay` at work: the time of a recording beside that of the event loop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable
from typing import Final

from ua_fleet.cli.opening import ToolKeys
from ua_fleet.errors import LocalWireError
from ua_fleet.pubsub.events import ProbeReceived
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.recording.opening import RecordedOpener
from ua_fleet.recording.playback import Playback, Replay
from ua_fleet.recording.records import Record
from ua_fleet.transport.base import Address, Transport
from ua_fleet.transport.sealed import SealedSender
from ua_fleet.values import ticks_from_unix_ns

__all__ = ["Replayer"]

LONGEST_SLEEP_S: Final = 0.5
YIELD_AFTER: Final = 64
"""Records in a row after which the event loop has its turn."""


def _wall_ticks() -> int:
    return ticks_from_unix_ns(time.time_ns())


class Replayer:
    """Sends what a recording tells, each value when it is due."""

    def __init__(
        self,
        replay: Replay,
        playback: Playback,
        opener: RecordedOpener,
        publisher: Publisher,
        subscriber: Subscriber,
        sender: SealedSender,
        speed: float,
        keys: ToolKeys | None = None,
    ) -> None:
        """Put the parts together; `subscriber` hears who asks for metadata, and `keys` keeps the sender in keys."""
        self._replay, self._playback, self._opener = replay, playback, opener
        self._publisher, self._subscriber, self._sender, self._speed = publisher, subscriber, sender, speed
        self._keys = keys
        self.records = 0

    async def play(self, transport: Transport, records: Iterable[Record]) -> None:
        """Play all of it, or until cancelled; then its sources are gone, and the transport is closed."""
        loop = asyncio.get_running_loop()
        await transport.start(self._receive)
        try:
            self._sender.send_all(self._publisher.begin(now=loop.time(), wall_ticks=_wall_ticks()))
            begun, first_ns, now = loop.time(), None, 0.0
            for record in records:
                first_ns = record.time_ns if first_ns is None else first_ns
                now = max(now, (record.time_ns - first_ns) / 1e9)
                await self._until(begun + now / self._speed)
                self._take(self._opener.open(record, now), now, is_fresh=not record.is_kept)
                self.records += 1
                if self.records % YIELD_AFTER == 0:
                    await asyncio.sleep(0)
        finally:
            self._sender.send_all(self._replay.end(loop.time()))
            await transport.close()

    async def _until(self, due: float) -> None:
        """Wait, and say meanwhile that the sources live."""
        loop = asyncio.get_running_loop()
        while (now := loop.time()) < due:
            if self._keys is not None:
                await self._keys.refresh()
            self._sender.send_all(self._publisher.poll(now, _wall_ticks()))
            deadline = self._publisher.next_deadline()
            wake = min(due, now + LONGEST_SLEEP_S, due if deadline is None else max(deadline, now))
            await asyncio.sleep(max(wake - now, 0.001))

    def _take(self, plain: bytes | None, now: float, *, is_fresh: bool) -> None:
        loop = asyncio.get_running_loop()
        for fact in self._playback.feed(plain, now, is_fresh=is_fresh):
            self._sender.send_all(self._replay.take(fact, now=loop.time(), wall_ticks=_wall_ticks()))

    def _receive(self, datagram: bytes, sender: Address) -> None:
        now = asyncio.get_running_loop().time()
        for event in self._subscriber.receive(datagram, now, sender):
            if isinstance(event, ProbeReceived):
                try:
                    self._sender.send_all(self._publisher.answer(event.probe, now))
                except LocalWireError:
                    continue
