"""What `ua-fleet pubsub probe` asks, and what it hears: sends probes until they are answered."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Final

from ua_fleet.cli.kind import HealthKind
from ua_fleet.cli.opening import REFRESH_S, Opener, ToolKeys
from ua_fleet.errors import RemoteWireError
from ua_fleet.transport.base import Address, Transport
from ua_fleet.transport.party import Brokered, tool_party
from ua_fleet.wire import Codec, encode_probe
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    ActionResponderAnnouncement,
    AnyAnnouncement,
    ApplicationAnnouncement,
    ConnectionsAnnouncement,
    EndpointsAnnouncement,
    StatusAnnouncement,
    WriterConfigurationAnnouncement,
)
from ua_fleet.wire.messages import MetaDataAnnouncement, NetworkMessage, Probe, ProbeKind, PublisherIdType

__all__ = ["ANSWERS", "Prober"]

FIRST_PERIOD_S: Final = 0.5
"""A probe that nobody answers is sent again after this time, then after twice as long (OPC 10000-14 7.2.4.6.12.2)."""
QUIET_S: Final = 0.8
"""After answers nothing more is expected when none came for so long: a Publisher may hold one back for 0.5 s."""
MOST_ANNOUNCEMENTS: Final = 100_000
UINT16: Final = PublisherIdType.UINT16.value
FIND_APPLICATIONS: Final = Probe(None, PublisherIdType.STRING, ProbeKind.FIND_APPLICATIONS)


ANSWERS: Final[dict[HealthKind, tuple[type, ...]]] = {
    HealthKind.METADATA: (MetaDataAnnouncement,),
    HealthKind.WRITERS: (WriterConfigurationAnnouncement,),
    HealthKind.GROUPS: (WriterConfigurationAnnouncement,),
    HealthKind.CONNECTIONS: (ConnectionsAnnouncement,),
    HealthKind.ENDPOINTS: (EndpointsAnnouncement,),
    HealthKind.APPLICATIONS: (ApplicationAnnouncement, StatusAnnouncement),
    HealthKind.ACTIONS: (ActionMetaDataAnnouncement, ActionResponderAnnouncement),
}


def probes_for(kind: HealthKind, publisher_id: int) -> list[Probe]:
    """The probes that ask one Publisher. Actions have no InformationType: they come with metadata and connections."""
    metadata = Probe(publisher_id, UINT16, ProbeKind.DATA_SET_META_DATA)
    connections = Probe(
        publisher_id,
        UINT16,
        ProbeKind.PUBSUB_CONNECTIONS,
        include_writer_groups=True,
        include_data_set_writers=True,
    )
    return {
        HealthKind.METADATA: [metadata],
        HealthKind.WRITERS: [Probe(publisher_id, UINT16, ProbeKind.DATA_SET_WRITER_CONFIGURATION)],
        HealthKind.GROUPS: [Probe(publisher_id, UINT16, ProbeKind.WRITER_GROUP_CONFIGURATION)],
        HealthKind.CONNECTIONS: [connections],
        HealthKind.ENDPOINTS: [Probe(publisher_id, UINT16, ProbeKind.ENDPOINTS)],
        HealthKind.APPLICATIONS: [FIND_APPLICATIONS],
        HealthKind.ACTIONS: [metadata, connections],
    }[kind]


class Prober:
    """Asks one Publisher, or finds all and asks each of them, and keeps what they announce."""

    def __init__(self, kind: HealthKind, publisher_id: int | None, opener: Opener) -> None:
        self._answers: dict[AnyAnnouncement, AnyAnnouncement] = {}
        """Each by itself without its SequenceNumber."""
        self.answered: set[int | str | None] = set()
        """Publishers that have answered."""
        self.found: set[int | str | None] = set()
        """Publishers that have said anything."""
        self._kind, self._publisher_id, self._opener = kind, publisher_id, opener
        self._codec = Codec()
        self._last_answer: float | None = None
        self._news = asyncio.Event()
        self._transport: Transport | None = None

    @property
    def answers(self) -> list[AnyAnnouncement]:
        """What was asked for, each once, in the order in which it came."""
        return list(self._answers.values())

    async def ask(self, transport: Transport, keys: ToolKeys | None, timeout_s: float) -> None:
        """Ask until no more answers come, or the time is over; then the transport is closed."""
        self._transport = transport
        if isinstance(transport, Brokered):
            transport.speak_for(tool_party(partial(self._receive, is_fresh=False)))
        loop = asyncio.get_running_loop()
        try:
            await transport.start(self._receive)
            end = loop.time() + timeout_s
            ask_at, period = loop.time(), FIRST_PERIOD_S
            while (now := loop.time()) < end:
                if self._last_answer is not None and now >= self._last_answer + QUIET_S and self._is_complete():
                    return
                if now >= ask_at:
                    self._send_probes()
                    ask_at, period = now + period, 2 * period
                if keys is not None:
                    await keys.refresh()
                self._news.clear()
                quiet_at = end if self._last_answer is None else self._last_answer + QUIET_S
                wake_at = min(end, ask_at, quiet_at if quiet_at > now else end)
                if keys is not None:
                    wake_at = min(wake_at, now + REFRESH_S)
                try:
                    async with asyncio.timeout_at(wake_at):
                        await self._news.wait()
                except TimeoutError:
                    pass
        finally:
            await transport.close()

    def _is_complete(self) -> bool:
        return self._publisher_id is not None or self.found <= self.answered

    def _send_probes(self) -> None:
        """Ask whoever has not answered yet."""
        if self._publisher_id is not None:
            if self._publisher_id not in self.answered:
                self._probe(self._publisher_id)
            return
        self._send(FIND_APPLICATIONS)
        if self._kind is not HealthKind.APPLICATIONS:
            for publisher_id in self.found - self.answered:
                self._probe(publisher_id)

    def _probe(self, publisher_id: int | str | None) -> None:
        if isinstance(publisher_id, int) and 0 <= publisher_id <= 0xFFFF:
            for probe in probes_for(self._kind, publisher_id):
                self._send(probe)

    def _send(self, probe: Probe) -> None:
        if self._transport is not None:
            self._opener.send(self._transport, encode_probe(probe))

    def _receive(self, datagram: bytes, _sender: Address, *, is_fresh: bool = True) -> None:
        now = asyncio.get_running_loop().time()
        opened = self._opener.open(datagram, now, is_fresh=is_fresh)
        if opened.plain is None:
            return
        try:
            decoded = self._codec.decode(opened.plain)
        except RemoteWireError as error:
            self._opener.counters.drop_malformed(error.cause)
            return
        if isinstance(decoded, NetworkMessage):
            if decoded.publisher_id_type == UINT16:
                self._meet(decoded.publisher_id)
        elif isinstance(decoded, AnyAnnouncement):
            self._hear(decoded, now)

    def _meet(self, publisher_id: int | str | None) -> None:
        """Know of a Publisher, and ask it where all are to be asked."""
        if publisher_id not in self.found and len(self.found) < MOST_ANNOUNCEMENTS:
            self.found.add(publisher_id)
            if self._publisher_id is None and self._kind is not HealthKind.APPLICATIONS:
                self._probe(publisher_id)

    def _hear(self, announcement: AnyAnnouncement, now: float) -> None:
        publisher_id = announcement.publisher_id
        if self._publisher_id is not None and publisher_id != self._publisher_id:
            return
        self._meet(publisher_id)
        if isinstance(announcement, ANSWERS[self._kind]) and len(self._answers) < MOST_ANNOUNCEMENTS:
            self.answered.add(publisher_id)
            self._answers.setdefault(announcement._replace(sequence_number=0), announcement)
            self._last_answer = now
            self._news.set()
