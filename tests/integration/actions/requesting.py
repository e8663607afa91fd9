"""A requestor without an OPC UA server: the server's SkillCommands over a transport, with its journal."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from random import Random
from typing import Any

import structlog

from tests.outcomes import Outcomes
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import envelope_of, file_keys_of
from ua_fleet.config.transports import open_transport
from ua_fleet.counters import Counters
from ua_fleet.keys.keeper import KeysKept, keep_keys
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.pubsub.events import (
    ActionReceived,
    AnnouncementReceived,
    DataReceived,
    ProbeDue,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.skill.journal import RequestorJournal
from ua_fleet.storage.server_records import ServerRecords
from ua_fleet.topics import Topic
from ua_fleet.transport.base import Address, Transport
from ua_fleet.transport.party import Brokered, Party
from ua_fleet.transport.sealed import SealedSender
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.values import ticks_from_unix_ns
from ua_fleet.wire import Codec
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement
from ua_fleet.wire.messages import DataSetMessage
from ua_fleet.wire.security import SecurityMode


class LossyTransport(UdpTransport):
    """Loses, repeats and so reorders what it sends and hears, the same way for the same seed."""

    def __init__(self, url: str, loss: float, seed: int) -> None:
        super().__init__(url, "lo")
        self.loss, self._random = loss, Random(seed)
        self.lost = 0

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        if self._is_lost():
            return
        super().send(datagram, address)
        if self._random.random() < self.loss:
            super().send(datagram, address)

    async def start(self, receive: Callable[[bytes, Address], None]) -> None:
        def receive_some(datagram: bytes, sender: Address) -> None:
            if not self._is_lost():
                receive(datagram, sender)

        await super().start(receive_some)

    def _is_lost(self) -> bool:
        is_lost = self._random.random() < self.loss
        self.lost += is_lost
        return is_lost


class Requesting:
    """One requestor at work."""

    def __init__(
        self,
        config: FleetConfig,
        folder: Path,
        transport: Transport,
        journal: RequestorJournal,
        space: int = 0,
        envelope: Envelope | None = None,
    ) -> None:
        self.counters, self.kept = Counters(), KeysKept()
        self.envelope = envelope or envelope_of(config, space, self.counters, folder)
        self.transport = transport
        self._sender = SealedSender(self.envelope, transport, lambda: asyncio.get_running_loop().time())
        if isinstance(transport, Brokered):
            transport.speak_for(
                Party(
                    publisher_id=space,
                    seal=self.envelope.seal,
                    token=self.envelope.sending_token,
                    is_secured=self.envelope.mode is not SecurityMode.NONE,
                    names_of=lambda _writer_id: None,
                    receive_kept=self.take_kept,
                )
            )
        self._subscriber = Subscriber(
            space, PubSubTiming(0.3, 1.0, 5.0), self.counters, Codec(), envelope=self.envelope
        )
        self.status: dict[Topic, DataSetMessage] = {}
        """The latest message of each data source."""
        self._outcomes = Outcomes()
        self.commands = SkillCommands(
            journal,
            send=self.send,
            want=self._subscriber.want_action,
            sooner=lambda: None,
            wall_ticks=lambda: ticks_from_unix_ns(time.time_ns()),
            must_be_verified=self.envelope.mode is not SecurityMode.NONE,
            space=space,
            told=self._outcomes.tell,
            clock=lambda: asyncio.get_running_loop().time(),
            log=structlog.get_logger(),
        )

    async def invoke(
        self, topic: Topic, values: tuple[Any, ...], timeout_s: float, execution_id: bytes | None = None
    ) -> RequestOutcome:
        """Have the robot do a skill, and wait until it is known whether it was told to."""
        return await self._outcomes.invoke(self.commands, topic, values, timeout_s, execution_id=execution_id)

    async def outcome(self, execution_id: bytes) -> RequestOutcome:
        """Wait for the outcome of a request that this run or one before has made."""
        return await self._outcomes.of(self.commands, execution_id)

    def send(self, datagram: bytes) -> None:
        self._sender.send(datagram)

    def take(self, datagram: bytes, sender: Address) -> None:
        """What the transport calls; a test may put another `receive` in its place."""
        self.receive(datagram, sender)

    def receive(self, datagram: bytes, sender: Address) -> None:
        self._take(self._subscriber.receive(datagram, self._now(), sender))

    def take_kept(self, datagram: bytes, sender: Address) -> None:
        """What a broker had kept."""
        self._take(self._subscriber.receive(datagram, self._now(), sender, is_fresh=False))

    def _now(self) -> float:
        return asyncio.get_running_loop().time()

    def _take(self, events: list[SubscriberEvent]) -> None:
        for event in events:
            if isinstance(event, ActionReceived):
                self.commands.receive(event, self._now())
            elif isinstance(event, AnnouncementReceived):
                if isinstance(event.announcement, ActionMetaDataAnnouncement):
                    self.commands.announced(event.announcement)
            elif isinstance(event, ProbeDue | SourceUnknown):
                if event.datagram is not None:
                    self.send(event.datagram)
            elif isinstance(event, DataReceived):
                self.status[event.topic] = event.message

    async def tick(self) -> None:
        while True:
            self._take(self._subscriber.poll(self._now()))
            self.commands.poll(self._now())
            await asyncio.sleep(0.01)


@asynccontextmanager
async def requesting(
    config: FleetConfig,
    folder: Path,
    *,
    space: int = 0,
    transport: Transport | None = None,
    journal: RequestorJournal | None = None,
    envelope: Envelope | None = None,
) -> AsyncGenerator[Requesting]:
    """A requestor that works while the context lasts; its journal is in `folder`."""
    opened = ServerRecords(folder) if journal is None else None
    transport = transport or open_transport(config, folder, space=space)
    requests = journal or (opened.requests if opened is not None else _none())
    requestor = Requesting(config, folder, transport, requests, space, envelope)
    tasks = [asyncio.ensure_future(requestor.tick())]
    try:
        await transport.start(requestor.take)
        if envelope is None and config.pubsub.is_secured:
            source = file_keys_of(config, space, folder.parent)
            tasks.append(asyncio.ensure_future(keep_keys(requestor.envelope, source, requestor.kept, count=2)))
            await requestor.kept.wait_for(requestor.envelope.groups_wanted())
        requestor.commands.resume(asyncio.get_running_loop().time())
        yield requestor
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        await transport.close()
        if opened is not None:
            opened.close()


def _none() -> RequestorJournal:
    raise AssertionError("a requestor has a journal")
