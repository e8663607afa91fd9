"""What a process says and hears over a broker: pure, time is an argument. `transport.py` is its shell.

    part to send    its subject -> outbox -> parcels, each with its topic, secured bytes and properties
    message heard   judged by its topic -> to the subscriber: fresh, or kept by the broker
    time            a new key, names that have changed, what the broker would forget

Of its own topics this process also looks after what others left there: a status that is not its own is said again, and
what was retained under a name that it does not have any more is cleared (OPC 10000-14 7.3.4.8).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

from ua_fleet.counters import Drop
from ua_fleet.errors import LocalWireError
from ua_fleet.transport.base import Address
from ua_fleet.transport.mqtt.incoming import Verdict, judge
from ua_fleet.transport.mqtt.outbox import KEPT_FOR_S, Outbox, Parcel
from ua_fleet.transport.mqtt.subject import Addressing, Lane, Subject
from ua_fleet.transport.mqtt.topics import Kind, TopicTree
from ua_fleet.transport.party import Party
from ua_fleet.wire import encode_announcement
from ua_fleet.wire.discovered import PubSubState, StatusAnnouncement
from ua_fleet.wire.messages import PublisherIdType
from ua_fleet.wire.outline import is_chunk

__all__ = ["MqttCore", "Outgoing"]

STRANGER_GRACE_S: Final = 30.0
"""So long what was retained in a former life stays, where it is not announced again."""
STATUS_AGAIN_S: Final = 1.0
_MOST_STRANGERS: Final = 10_000
_OF_DISCOVERY_QOS: Final = 1


class Outgoing(NamedTuple):
    """One PUBLISH."""

    parcel: Parcel
    topic: str
    payload: bytes
    qos: int
    is_retained: bool
    kind: Kind
    expiry_s: int | None
    """Message Expiry Interval, which MQTT 5 has."""


class MqttCore:
    """See the module."""

    def __init__(
        self,
        party: Party,
        tree: TopicTree,
        outbox: Outbox,
        *,
        qos: int = 1,
        keep_alive_expiry_s: float = 3.0,
        max_payload_bytes: int = 256 * 1024,
    ) -> None:
        """Make it.

        Args:
            party: for whom it speaks.
            tree: the topics.
            outbox: what waits.
            qos: of data; discovery and Actions have 1.
            keep_alive_expiry_s: a keep-alive that is older says nothing any more.
            max_payload_bytes: of what the broker can retain, since that is one message.
        """
        self._party, self._tree, self._outbox, self._qos = party, tree, outbox, qos
        self._addressing = Addressing(tree, party.names_of, party.setpoint_groups)
        self._keep_alive_expiry_s = max(math.ceil(keep_alive_expiry_s), 1)
        self._max_payload_bytes = max_payload_bytes
        self._token = 0
        self._topics: dict[tuple[Kind, int], str] = {}
        """Where the metadata of each DataSetWriter of this process is retained."""
        self._strangers: dict[str, tuple[Kind, float]] = {}
        """What the broker retains in our name and we did not send, and since when we know."""
        self._status_at = float("-inf")
        self.drops: dict[Drop, int] = {}

    @property
    def filters(self) -> list[str]:
        """What to subscribe to."""
        return self._tree.filters(self._party.publisher_id)

    @property
    def status_topic(self) -> str | None:
        """Where this process says how it is; None for a tool."""
        publisher = self._party.publisher_id
        return None if publisher is None else self._tree.topic(Kind.STATUS, publisher)

    def will(self, now: float) -> bytes | None:
        """What the broker is to say when the connection breaks (7.3.4.7.7); None for a tool, or without a key."""
        publisher = self._party.publisher_id
        if publisher is None:
            return None
        status = StatusAnnouncement(publisher, PublisherIdType.UINT16.value, 0, False, PubSubState.ERROR.value)
        parts = self._party.seal(encode_announcement(status), now)
        return parts[0] if parts else None

    def send(self, part: bytes, plain: bytes, address: Address | None, now: float, wall_ticks: int) -> None:
        """Take a datagram of a message that is to be sent."""
        self._look_at_key(now)
        subject = self._addressing.subject(plain, wall_ticks)
        if subject is None:
            self._drop(Drop.BROKER_REFUSED)
            return
        if subject.lifetime_s is not None and subject.lifetime_s <= 0.0:
            self._drop(Drop.EXPIRED)
            return
        topic = subject.topic
        if address is not None and subject.kind is Kind.ACTION_RESPONSE:
            topic = self._tree.answer(address[0]) or address[0]
        if subject.lane is not Lane.KEPT:
            self._outbox.put(Parcel(subject, part, plain, now, topic), now)
            return
        if len(part) > self._max_payload_bytes or is_chunk(part):
            # It goes in chunks, of which a broker would retain the last one only.
            self._outbox.put(Parcel(subject._replace(lane=Lane.COMMAND, lifetime_s=5.0), part, plain, now, topic), now)
            return
        self._note_topic(subject, now)
        self._strangers.pop(topic, None)
        self._outbox.put(Parcel(subject, part, plain, now, topic), now)

    def take(self, now: float) -> Iterator[Outgoing]:
        """What is to be sent now; to be used up at once."""
        for parcel in self._outbox.take(now):
            payload = parcel.payload
            if payload is None:
                payload = self._sealed(parcel.plain, now)
                if payload is None:
                    self._outbox.not_secured(parcel)
                    continue
            yield self._outgoing(parcel, payload, now)

    def acknowledged(self, parcel: Parcel, *, is_refused: bool = False) -> None:
        """What was sent has arrived at the broker, or was refused there."""
        self._outbox.acknowledged(parcel)
        if is_refused:
            self._drop(Drop.BROKER_REFUSED)

    def connected(self, now: float, receive_maximum: int = 65_535) -> None:
        """There is a connection, to a broker that takes so many messages in flight."""
        self._token = self._party.token(now)
        self._outbox.connected(now, receive_maximum)

    def disconnected(self) -> None:
        """There is none any more."""
        self._outbox.disconnected()

    def received(self, topic: str, payload: bytes, now: float, *, is_retained: bool) -> Verdict | None:
        """Judge a message of the broker; None where there is nothing to hand on."""
        if not payload:  # what clears a retained message comes to those who are subscribed
            return None
        verdict = judge(self._tree, topic, payload, is_retained=is_retained)
        if verdict is Verdict.NOT_ITS_TOPIC:
            self._drop(Drop.NOT_ITS_TOPIC)
            return None
        if verdict is Verdict.KEPT:
            self._look_at_own(topic, now)
        return verdict

    def answer_address(self, response_address: str | None, sender: Address) -> Address | None:
        """Where a response goes: to the standard topic, or to one that the requestor named."""
        if not response_address:
            return sender if self._tree.answer(sender[0]) is not None else None
        topic = self._tree.response_topic(response_address)
        return None if topic is None else (topic, 0)

    def poll(self, now: float) -> None:
        """What time has brought; each second is often enough."""
        self._look_at_key(now)
        self._outbox.poll(now)
        for (kind, writer_id), topic in list(self._topics.items()):
            if self._party.names_of(writer_id) is None:
                del self._topics[kind, writer_id]
                self._outbox.clear(topic, kind, now)
        for topic, (kind, since) in list(self._strangers.items()):
            if now - since >= STRANGER_GRACE_S:
                del self._strangers[topic]
                self._outbox.clear(topic, kind, now)

    def clear_all(self, now: float) -> None:
        """Have the broker retain nothing but the status: it does not forget by itself (MQTT 3.1.1)."""
        for topic, subject in self._outbox.kept().items():
            if subject.kind is not Kind.STATUS:
                self._outbox.clear(topic, subject.kind, now)

    @property
    def is_empty(self) -> bool:
        """Whether everything was sent and acknowledged."""
        return not self._outbox.in_flight and not self._outbox.waiting

    def is_stuck(self, now: float) -> bool:
        """Whether the broker does not acknowledge what it was sent."""
        return self._outbox.is_stuck(now)

    def take_drops(self) -> dict[Drop, int]:
        """What was dropped since this was asked last."""
        drops = self._outbox.take_drops()
        for cause, count in self.drops.items():
            drops[cause] = drops.get(cause, 0) + count
        self.drops = {}
        return drops

    def _outgoing(self, parcel: Parcel, payload: bytes, now: float) -> Outgoing:
        subject, topic = parcel.subject, parcel.topic or parcel.subject.topic
        is_kept = subject.lane is Lane.KEPT
        expiry_s: int | None = None
        if is_kept:
            expiry_s = KEPT_FOR_S if payload else None
        elif (deadline := parcel.deadline) is not None:
            expiry_s = max(math.ceil(deadline - now), 1)
        elif subject.is_keep_alive:
            expiry_s = self._keep_alive_expiry_s
        is_value = subject.lane is Lane.VALUE
        qos = self._qos if is_value else _OF_DISCOVERY_QOS
        if subject.lane is Lane.COMMAND and subject.kind is Kind.DATA:
            qos = 0  # a setpoint: the next one is there before this one could be sent again
        return Outgoing(parcel, topic, payload, qos, is_kept, subject.kind, expiry_s)

    def _sealed(self, plain: bytes, now: float) -> bytes | None:
        if not plain:
            return b""
        try:
            parts = self._party.seal(plain, now)
        except LocalWireError:
            return None
        return parts[0] if len(parts) == 1 else None

    def _look_at_key(self, now: float) -> None:
        """Under a new key everything that is kept goes again, before what is secured with it."""
        token = self._party.token(now)
        if token != self._token:
            self._token = token
            self._outbox.renewed(now)

    def _note_topic(self, subject: Subject, now: float) -> None:
        """Clear the topic that a DataSetWriter had under another name."""
        if subject.writer is None:
            return
        key = subject.kind, subject.writer[1]
        before = self._topics.get(key)
        self._topics[key] = subject.topic
        if before is not None and before != subject.topic:
            self._outbox.clear(before, subject.kind, now)

    def _look_at_own(self, topic: str, now: float) -> None:
        """Say our status again where another one stands, and note what we have not sent."""
        place = self._tree.read(topic)
        if place is None or self._party.publisher_id is None or place.publisher != str(self._party.publisher_id):
            return
        kept = self._outbox.kept()
        if place.kind is Kind.STATUS:
            if topic in kept and now - self._status_at >= STATUS_AGAIN_S:
                self._status_at = now
                self._outbox.again(topic, now)
        elif topic not in kept and len(self._strangers) < _MOST_STRANGERS:
            self._strangers.setdefault(topic, (place.kind, now))

    def _drop(self, cause: Drop) -> None:
        self.drops[cause] = self.drops.get(cause, 0) + 1
