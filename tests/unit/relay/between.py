"""A writer in the hall, a reader at the site, and a relay between, which is all that they have in common."""

from __future__ import annotations

from collections.abc import Iterable
from random import Random
from typing import Any

from tests.unit.pubsub.publishing import CODEC, TOPIC, Writing
from tests.unit.pubsub.security.securing import ENCRYPT, NONE, envelope
from ua_fleet.counters import Counters
from ua_fleet.pubsub import ProbeReceived, PubSubTiming, Subscriber, SubscriberEvent
from ua_fleet.pubsub.origins import Direction, Origins
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.groups import relay_group, telemetry_group
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.relay import Forwarded, RelayCore, RelayedConnection
from ua_fleet.wire import SecurityMode

HALL, SITE = 0, 1
GATE = relay_group("gate")
RELAY = 254
SETPOINTS = {900: 1}
"""The WriterGroup of setpoints for space 1."""


def relay_envelope(*groups: str, mode: SecurityMode = ENCRYPT, **more: Any) -> Envelope:
    return envelope(
        RELAY, *(groups if mode is not NONE else ()), mode=mode, speaks_under=GATE, setpoint_groups=SETPOINTS, **more
    )


class Between:
    """See the module. `mode` is that of both connections; `ids` are PublisherIds that are no spaces."""

    def __init__(
        self,
        origins: Origins | None = None,
        *,
        mode: SecurityMode = ENCRYPT,
        trusted: Origins | None = None,
        takes_one: bool = False,
        ids: PublisherIds | None = None,
        **more: Any,
    ) -> None:
        self.mode = mode
        self.origins = Origins([TOPIC.space]) if origins is None else origins
        self.writing = Writing()
        self.ids = ids
        self.own = envelope(TOPIC.space, *self._groups(telemetry_group(TOPIC.space)), mode=mode, publisher_ids=self.ids)
        self.more: dict[str, Any] = {"publisher_ids": ids, **more}
        self.takes_one = takes_one
        self.counters, self.nonces = Counters(), MemoryNonces()
        self.relay = self.made()
        self.read_counters = Counters()
        self.trusted = self.origins if trusted is None else trusted
        self.reading = envelope(
            0,
            *self._groups(GATE),
            mode=mode,
            relayed=dict.fromkeys(self.trusted.publishers, GATE),
            random=1,
            publisher_ids=ids,
        )
        self.subscriber = Subscriber(
            0,
            PubSubTiming(),
            self.read_counters,
            CODEC,
            envelope=self.reading,
            barred=(TOPIC.space,),
            relayed=self.trusted,
            publisher_ids=ids,
            random=Random(1),
        )

    def _groups(self, *groups: str) -> tuple[str, ...]:
        return () if self.mode is NONE else groups

    def made(self) -> RelayCore:
        """A relay that has just been started, again with the nonces that it has not used."""
        given: dict[str, Any] = {"mode": self.mode, "nonces": self.nonces, "publisher_ids": self.ids}
        self.on = [
            RelayedConnection(relay_envelope(GATE, telemetry_group(TOPIC.space), **given)),
            RelayedConnection(relay_envelope(GATE, **given), self.takes_one),
        ]
        return RelayCore(
            self.on,
            [Direction(HALL, SITE, self.origins)],
            self.counters,
            CODEC,
            receive_timeout_s=3.0,
            random=Random(1),
            **self.more,
        )

    @property
    def now(self) -> float:
        return self.writing.now

    def said(self, datagrams: Iterable[bytes], *, is_fresh: bool = True) -> list[Forwarded]:
        """The writer says something in the hall; what the relay makes of it."""
        return [
            forwarded
            for plain in datagrams
            for sealed in self.own.seal(plain, self.now)
            for forwarded in self.relay.receive(HALL, sealed, self.now, is_fresh=is_fresh)
        ]

    def heard(self, forwarded: Iterable[Forwarded]) -> list[SubscriberEvent]:
        """What reaches the reader; what is for the hall reaches the writer, who answers."""
        events: list[SubscriberEvent] = []
        for connection, plain in forwarded:
            if connection == SITE:
                for sealed in self.sealed(plain):
                    events += self.subscriber.receive(sealed, self.now)
            else:
                events += self.heard(self.said(self.answered(plain)))
        return events

    def sealed(self, plain: bytes) -> list[bytes]:
        """As the relay sends it at the site."""
        return self.on[SITE].envelope.seal(plain, self.now)

    def answered(self, probe: bytes) -> list[bytes]:
        """What the writer says to a probe."""
        subscriber = Subscriber(TOPIC.space, PubSubTiming(), Counters(), CODEC)
        events = subscriber.receive(probe, self.now)
        return [
            each
            for event in events
            if isinstance(event, ProbeReceived)
            for each in self.writing.publisher.answer(event.probe, self.now)
        ]

    def carry(self, datagrams: Iterable[bytes], *, is_fresh: bool = True) -> list[SubscriberEvent]:
        return self.heard(self.said(datagrams, is_fresh=is_fresh))
