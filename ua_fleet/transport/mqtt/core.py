"""What a process says and hears over a broker: pure, time is an argument. `transport.py` is its shell.

    part to send    its subject -> outbox -> parcels, each with its topic, secured bytes and properties
    message heard   judged by its topic -> to the subscriber: fresh, or kept by the broker
    over JSON       text in place of secured bytes: what comes in and goes out above is UADP all the same
    time            a new key, names that have changed, what the broker would forget

Of its own topics this process also looks after what others left there: a status that is not its own is said again, and
what was retained under a name that it does not have any more is cleared (OPC 10000-14 7.3.4.8).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any, Final, NamedTuple
from urllib.parse import unquote

from ua_fleet.counters import Drop
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.pubsub.configuring import group_number
from ua_fleet.topics import SERVER_SPACE
from ua_fleet.transport.base import Address
from ua_fleet.transport.mqtt.incoming import Verdict, judge, usual_heads
from ua_fleet.transport.mqtt.json import Descriptions, JsonReader, JsonSettings, JsonWriter, NotItsTopic
from ua_fleet.transport.mqtt.outbox import KEPT_FOR_S, Outbox, Parcel
from ua_fleet.transport.mqtt.subject import Addressing, Lane, Subject
from ua_fleet.transport.mqtt.topics import ACTION_KINDS, MOST_REMEMBERED, Kind, Place, TopicTree
from ua_fleet.transport.party import Party
from ua_fleet.values import TICKS_PER_SECOND
from ua_fleet.wire import encode_announcement
from ua_fleet.wire.discovered import PubSubState, StatusAnnouncement
from ua_fleet.wire.json import Limits
from ua_fleet.wire.messages import PublisherIdType
from ua_fleet.wire.outline import is_chunk

__all__ = ["Heard", "MqttCore", "Outgoing"]

STRANGER_GRACE_S: Final = 30.0
"""So long what was retained in a former life stays, where it is not announced again."""
STATUS_AGAIN_S: Final = 1.0
_MOST_STRANGERS: Final = 10_000
_OF_DISCOVERY_QOS: Final = 1


class Heard(NamedTuple):
    """A datagram for the subscriber."""

    datagram: bytes
    is_fresh: bool
    """Whether it was sent just now; what a broker had kept may be of any time."""


class Outgoing(NamedTuple):
    """One PUBLISH."""

    parcel: Any
    """Given back when it has arrived."""
    topic: str
    payload: bytes
    qos: int
    is_retained: bool
    kind: Kind | None
    """None for what is no message of PubSub."""
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
        max_text_bytes: int = 4 * 1024 * 1024,
        json: JsonSettings | None = None,
    ) -> None:
        """Make it.

        Args:
            party: for whom it speaks.
            tree: the topics.
            outbox: what waits.
            qos: of data; discovery and Actions have 1.
            keep_alive_expiry_s: a keep-alive that is older says nothing any more.
            max_payload_bytes: of what the broker can retain, since that is one message. A text has no chunks.
            max_text_bytes: of a message as JSON.
            json: how JSON is spoken; without it UADP is. The topics are those of the same encoding.
        """
        self._party, self._tree, self._outbox, self._qos, self._json = party, tree, outbox, qos, json
        self._addressing = Addressing(tree, party.names, party.setpoint_groups)
        self._keep_alive_expiry_s = max(math.ceil(keep_alive_expiry_s), 1)
        self._max_payload_bytes, self._max_text_bytes = max_payload_bytes, max_text_bytes
        own, others = Descriptions(), Descriptions()
        self._writer: JsonWriter | None = None
        self._reader: JsonReader | None = None
        if json is not None:
            self._writer = JsonWriter(tree, party.names, own, others, form=json.form)
            limits = Limits(bytes=max_text_bytes)
            self._reader = JsonReader(
                party.publisher_id, own, others, stated=json.stated, described=json.described, limits=limits
            )
        self._wall_offset = 0
        """Ticks of the wall clock at time 0."""
        self._token = 0
        self._topics: dict[tuple[Kind, int | str, int], str] = {}
        """Where the metadata of each DataSetWriter that this process speaks for is retained."""
        self._strangers: dict[str, tuple[Kind, float]] = {}
        """What the broker retains in our name and we did not send, and since when we know."""
        self._status_at = float("-inf")
        self._usual: dict[str, tuple[bytes, ...]] = {}
        """How messages begin that are what their topic says, by topics on which values came."""
        self.drops: dict[Drop, int] = {}
        self.malformed = Counter[str]()
        """JSON that could not be read, by cause, since this was emptied last."""
        self.details: dict[str, str] = {}
        """Of the last message of each cause, and of the last one that JSON could not hold."""

    @property
    def filters(self) -> dict[str, int]:
        """What to subscribe to, in this order, and with which QoS."""
        qos = dict.fromkeys(self._tree.filters(self._party.publisher_id), max(self._qos, _OF_DISCOVERY_QOS))
        return qos | dict.fromkeys(self._tree.data_filters, self._qos)

    @property
    def status_topic(self) -> str | None:
        """Where this process says how it is; None for a tool."""
        publisher = self._party.publisher_id
        return None if publisher is None else self._tree.topic(Kind.STATUS, publisher)

    def will(self, now: float) -> bytes | None:
        """What the broker is to say when the connection breaks (7.3.4.7.7); None for a tool, or without a key."""
        publisher = self._party.publisher_id
        if publisher is None or (self._party.is_secured and not self._party.token(now)):
            return None
        status = StatusAnnouncement(publisher, PublisherIdType.UINT16.value, 0, False, PubSubState.ERROR.value)
        return self._sealed(encode_announcement(status), now)

    def send(self, part: bytes, plain: bytes, address: Address | None, now: float, wall_ticks: int) -> None:
        """Take a datagram of a message that is to be sent."""
        self._look_at_key(now)
        self._wall_offset = wall_ticks - round(now * TICKS_PER_SECOND)
        subject = self._addressing.subject(plain, wall_ticks)
        if subject is None:
            self._drop(Drop.BROKER_REFUSED)
            return
        if subject.lifetime_s is not None and subject.lifetime_s <= 0.0:
            self._drop(Drop.EXPIRED)
            return
        if self._writer is not None:
            text = self._text(self._writer, subject, plain, wall_ticks)
            if text is None:
                return
            part = text
        topic = subject.topic
        if address is not None and subject.kind is Kind.ACTION_RESPONSE:
            topic = self._tree.answer(address[0]) or address[0]
        if subject.lane is not Lane.KEPT:
            self._outbox.put(Parcel(subject, part, plain, now, topic), now)
            return
        if self._writer is None and (len(part) > self._max_payload_bytes or is_chunk(part)):
            # It goes in chunks, of which a broker would retain the last one only.
            self._outbox.put(Parcel(subject._replace(lane=Lane.COMMAND, lifetime_s=5.0), part, plain, now, topic), now)
            return
        self._note_topic(subject, now)
        self._strangers.pop(topic, None)
        self._outbox.put(Parcel(subject, part, plain, now, topic), now)

    def take(self, now: float) -> Iterator[Outgoing]:
        """What is to be sent now; to be used up at once."""
        for parcel in self._outbox.take(now):
            is_late = self._party.names_of_origin is not None and now - parcel.arrived > self._keep_alive_expiry_s
            if is_late and self._outbox.expired(parcel):  # a relay does not know whether its source is there
                continue
            payload = parcel.payload
            if payload is None or (parcel.has_waited and self._writer is None and not is_chunk(payload)):
                payload = self._sealed(parcel.plain, now) or payload
                parcel.payload = payload if parcel.has_waited else None  # as long as before
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

    def is_usual(self, topic: str, payload: bytes) -> bool:
        """Whether a message that is not retained is a value as most are, which `received` would hand on as it is."""
        return payload.startswith(self._usual.get(topic, ()))

    def received(self, topic: str, payload: bytes, now: float, *, is_retained: bool) -> list[Heard]:
        """Judge a message of the broker: what of it is handed on."""
        if not payload:  # what clears a retained message comes to those who are subscribed
            return []
        if self._reader is not None:
            return self._read(self._reader, topic, payload, now, is_retained=is_retained)
        verdict = judge(self._tree, topic, payload, is_retained=is_retained)
        if verdict is Verdict.NOT_ITS_TOPIC:
            self._drop(Drop.NOT_ITS_TOPIC)
            return []
        if verdict is Verdict.KEPT:
            self._look_at_own(topic, now)
        elif (place := self._tree.read(topic)) is not None and (heads := usual_heads(self._tree, place)):
            if len(self._usual) >= MOST_REMEMBERED:
                self._usual.clear()
            self._usual[topic] = heads
        return [Heard(payload, verdict is Verdict.FRESH)]

    def answer_address(self, response_address: str | None, sender: Address) -> Address | None:
        """Where a response goes: to the standard topic, or to one that the requestor named."""
        if not response_address:
            return sender if self._tree.answer(sender[0]) is not None else None
        topic = self._tree.response_topic(response_address)
        return None if topic is None else (topic, 0)

    def late(self, now: float) -> list[Heard]:
        """What was held for metadata that did not come."""
        return [] if self._reader is None else [Heard(plain, True) for plain in self._reader.poll(now)]

    def poll(self, now: float) -> None:
        """What time has brought; each second is often enough."""
        self._look_at_key(now)
        self._outbox.poll(now)
        for (kind, publisher, writer_id), topic in list(self._topics.items()):
            if self._party.names(publisher, writer_id) is None:
                del self._topics[kind, publisher, writer_id]
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

    def take_forgiven(self) -> Counter[str]:
        """What was forgiven in JSON since this was asked last, by name."""
        forgiven = Counter[str]()
        if self._reader is not None:
            forgiven, self._reader.forgiven = self._reader.forgiven, forgiven
        return forgiven

    def _text(self, writer: JsonWriter, subject: Subject, plain: bytes, wall_ticks: int) -> bytes | None:
        """A message as JSON; None for one that does not go over JSON, which is counted where somebody misses it."""
        assert self._json is not None
        is_setpoint = subject.kind is Kind.DATA and subject.lane is Lane.COMMAND
        if is_setpoint or (subject.kind in ACTION_KINDS and not self._json.has_actions):
            if subject.lane is Lane.COMMAND:
                self._drop(Drop.NOT_OVER_JSON)
            return None
        try:
            text = writer.encode(plain, wall_ticks)
        except LocalWireError as error:
            self._drop(Drop.CONVERSION)
            self.details["conversion"] = f"{subject.topic}: {error}"
            return None
        if text is not None and len(text) > self._max_text_bytes:
            self._drop(Drop.BROKER_REFUSED)
            return None
        return text

    def _read(self, reader: JsonReader, topic: str, payload: bytes, now: float, *, is_retained: bool) -> list[Heard]:
        """Judge a message of JSON, and make UADP of it."""
        place = self._tree.read(topic)
        if place is None:
            self._drop(Drop.NOT_ITS_TOPIC)
            return []
        if is_retained and not place.kind.is_kept:  # before it is read: it says nothing, whatever stands there
            self._drop(Drop.RETAINED)
            return []
        if self._is_setpoint(place):
            self._drop(Drop.NOT_OVER_JSON)
            return []
        is_fresh = not is_retained and place.kind is not Kind.STATUS
        try:
            found = reader.read(place, payload, now, is_fresh=is_fresh)
        except NotItsTopic:
            self._drop(Drop.NOT_ITS_TOPIC)
            return []
        except RemoteWireError as error:
            self.malformed[error.cause] += 1
            self.details[error.cause] = f"{topic[:100]}: {error}"
            return []
        finally:
            for cause, number in reader.drops.items():
                self._drop(cause, number)
            reader.drops.clear()
        if not is_fresh:
            self._look_at_own(topic, now)
        # What comes after metadata has waited for it, and was sent just now, even where the metadata was kept.
        return [Heard(plain, is_fresh or index > 0) for index, plain in enumerate(found)]

    def _is_setpoint(self, place: Place) -> bool:
        """Whether a topic is one of setpoints: a queue of the server, or the standard topic of its WriterGroup."""
        if place.kind is not Kind.DATA or place.publisher != str(SERVER_SPACE):
            return False
        ns = group_number(unquote(place.names[0])) if place.source is None else place.source.ns
        return ns in self._party.setpoint_groups

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
        qos = self._qos if subject.lane is Lane.VALUE else _OF_DISCOVERY_QOS
        if subject.lane is Lane.COMMAND and subject.kind is Kind.DATA:
            qos = 0  # a setpoint: the next one is there before this one could be sent again
        return Outgoing(parcel, topic, payload, qos, is_kept, subject.kind, expiry_s)

    def _sealed(self, plain: bytes, now: float) -> bytes | None:
        if not plain:
            return b""
        if self._writer is not None:
            try:
                return self._writer.encode(plain, self._wall_offset + round(now * TICKS_PER_SECOND))
            except LocalWireError:
                return None
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
        if subject.writer is None or subject.publisher is None:
            return
        key = subject.kind, subject.publisher, subject.writer[1]
        before = self._topics.get(key)
        self._topics[key] = subject.topic
        if before is not None and before != subject.topic:
            self._outbox.clear(before, subject.kind, now)

    def _look_at_own(self, topic: str, now: float) -> None:
        """Say our status again where another one stands, and note what we have not sent."""
        place, publisher = self._tree.read(topic), self._party.publisher_id
        own = None if publisher is None else self._tree.level(publisher)
        if place is None or own is None or place.publisher != own:
            return
        kept = self._outbox.kept()
        if place.kind is Kind.STATUS:
            if topic in kept and now - self._status_at >= STATUS_AGAIN_S:
                self._status_at = now
                self._outbox.again(topic, now)
        elif topic not in kept and len(self._strangers) < _MOST_STRANGERS:
            self._strangers.setdefault(topic, (place.kind, now))

    def _drop(self, cause: Drop, count: int = 1) -> None:
        self.drops[cause] = self.drops.get(cause, 0) + count
