"""What a relay forwards, and what not: pure, datagrams and the time are arguments.

    a message of a listed origin, on a connection that it is forwarded from

      Action, setpoint         never forwarded; counted
      data                     its DataSetMessages as they are: sequence number, Timestamp, status, keep-alives too
      metadata                 remembered; it goes before the first message that it describes, and to who asks for it
      the publisher's state    as it is
      who and where it is      not forwarded: that is of the connection that it is on

    a message of any other origin, or of one that is sent there: not forwarded, and counted

A relay has no opinion of its own. Who hears it hears the same sequence, and so has the same rules: what comes by
another road, too, falls by its number or its Timestamp, and a source lives while its own keep-alives come through. So
nothing has to be remembered over a restart but what publishers say again: their metadata is asked for at once, and
without it nothing is forwarded.

Each origin has one direction. It goes where it is configured to go, and what comes back from there is not taken: that
holds for every relay, and the configuration sees to it that no ring of relays is made (`config/relay_checks.py`).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Iterator, Sequence
from random import Random
from typing import Final, NamedTuple

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.pubsub.catalog import Catalog
from ua_fleet.pubsub.complaints import Complaint, Complaints
from ua_fleet.pubsub.configuring import group_name
from ua_fleet.pubsub.inlet import Inlet
from ua_fleet.pubsub.origins import NO_ORIGINS, Direction, Origins
from ua_fleet.pubsub.probing import ProbeSchedule
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.pubsub.remote_writer import RemoteWriter
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.pubsub.sequence import MASK
from ua_fleet.pubsub.wishes import IDS_IN_PROBE
from ua_fleet.topics import Topic
from ua_fleet.values import Quality, quality_of
from ua_fleet.wire import Codec, encode_announcement, encode_probe, read_security
from ua_fleet.wire.discovered import StatusAnnouncement
from ua_fleet.wire.generic import Decoded
from ua_fleet.wire.header import MESSAGE_TYPE_BITS, MessageType
from ua_fleet.wire.messages import (
    DataSetMessage,
    DataSetMetaData,
    MetaDataAnnouncement,
    NetworkMessage,
    Probe,
    ProbeKind,
    PublisherIdType,
)
from ua_fleet.wire.security import SecuredDatagram

__all__ = ["ANSWER_INTERVAL_S", "Forwarded", "RelayCore", "RelayedConnection"]

ANSWER_INTERVAL_S: Final = 1.0
"""The same is answered, and asked for on behalf of others, once in so long."""
NOBODY: Final = -1
"""The space of a relay: it has none."""
_NEVER: Final = float("-inf")
_UINT16: Final = PublisherIdType.UINT16.value
_PROBE: Final = MessageType.PROBE << 2

_Key = tuple[int, int]
"""PublisherId and DataSetWriterId, as metadata names a DataSetWriter."""


class RelayedConnection(NamedTuple):
    """One connection of a relay, as its core needs it."""

    envelope: Envelope
    takes_one: bool = False
    """Whether what is sent there has one DataSetMessage each, as a broker wants it."""
    relayed: Origins = NO_ORIGINS
    """What comes by it by other relays."""


class Forwarded(NamedTuple):
    """A plain message that is to be secured and sent by a connection."""

    connection: int
    plain: bytes


class _Road:
    """One direction, with what it knows of the writers on it."""

    def __init__(self, direction: Direction, max_writers: int, random: Random) -> None:
        self.source, self.target, self.origins = direction
        self.writers: OrderedDict[Topic, RemoteWriter] = OrderedDict()
        """Those that were heard, the longest silent first. `metadata` of one is what was forwarded last."""
        self.catalog = Catalog(max_writers)
        self.probes = ProbeSchedule(random)
        self.answered: dict[_Key, float] = {}
        """When the metadata of a DataSetWriter was said to who had asked for it."""
        self.asked: dict[int, float] = {}
        """When each publisher was asked on behalf of somebody."""


class RelayCore:
    """See the module. It never raises on a datagram."""

    def __init__(
        self,
        connections: Sequence[RelayedConnection],
        directions: Sequence[Direction],
        counters: Counters,
        codec: Codec,
        *,
        receive_timeout_s: float,
        publisher_ids: PublisherIds | None = None,
        stated: Collection[_Key] = (),
        max_writers: int = 50_000,
        random: Random | None = None,
    ) -> None:
        """Make a relay that knows no writers.

        Args:
            connections: those that it is on.
            directions: what goes from which to which. No publisher is in two of them that begin, or end, at one place.
            counters: what is received, forwarded and dropped is counted here.
            codec: the process's codec.
            receive_timeout_s: MessageReceiveTimeout; who was not heard for so long is not asked any more.
            publisher_ids: of spaces that have another PublisherId on the wire.
            stated: DataSetWriters that announce no metadata, since `fleet.yaml` says what their messages hold.
            max_writers: most writers of a direction; beyond, the longest silent one is forgotten.
            random: spreads probes.
        """
        random = random or Random()  # noqa: S311 - keeps no secret
        self._connections, self._counters, self._codec = tuple(connections), counters, codec
        self._timeout, self._stated, self._max_writers = receive_timeout_s, frozenset(stated), max_writers
        self._complaints = Complaints()
        self._publisher_ids = publisher_ids
        self._inlets = [
            Inlet(
                NOBODY,
                counters,
                codec,
                self._complaints,
                lambda _publisher: True,
                envelope=connection.envelope,
                publisher_ids=publisher_ids,
                relayed=connection.relayed,
                takes_actions=False,
            )
            for connection in self._connections
        ]
        self._roads = [_Road(direction, max_writers, random) for direction in directions]
        self._number = 0
        self._by_source: dict[tuple[int, int], list[_Road]] = {}
        self._by_target: dict[tuple[int, int], list[_Road]] = {}
        for road in self._roads:
            for publisher in road.origins.publishers:
                self._by_source.setdefault((road.source, publisher), []).append(road)
                self._by_target.setdefault((road.target, publisher), []).append(road)

    def begin(self) -> list[Forwarded]:
        """Ask all origins for their metadata: they say their last values with it."""
        found: list[Forwarded] = []
        for road in self._roads:
            for publisher in sorted(road.origins.publishers):
                ids = road.origins.writer_ids(publisher)
                found += self._probes(road, publisher, sorted(ids or ()))
        return found

    def receive(self, connection: int, datagram: bytes, now: float, *, is_fresh: bool = True) -> list[Forwarded]:
        """Take one datagram; what is to be sent for it.

        Args:
            connection: the number of the connection that it came by.
            datagram: as it came.
            now: the time.
            is_fresh: False for what a broker has kept.
        """
        envelope = self._connections[connection].envelope
        try:
            heard = read_security(datagram)
        except RemoteWireError as error:
            self._counters.drop_malformed(error.cause)
            self._complaints.add(error)
            return []
        if self._publisher_ids is not None:
            heard = self._publisher_ids.named(heard)
        if heard.is_discovery and datagram[2] & MESSAGE_TYPE_BITS == _PROBE:
            message = self._opened(connection, datagram, now, is_fresh=is_fresh)
            return self._answer(connection, message, now) if isinstance(message, Probe) else []
        if heard.is_action or envelope.is_setpoint(heard):
            self._count(heard, Drop.NOT_RELAYED)
            return []
        roads = self._roads_of(connection, heard)
        if not roads:
            return []
        message = self._opened(connection, datagram, now, is_fresh=is_fresh)
        if message is None:
            return []
        if isinstance(message, NetworkMessage):
            self._counters.messages_in += len(message.messages)
        found: list[Forwarded] = []
        for road in roads:
            found += self._forward(road, message, now, is_fresh=is_fresh)
        return found

    def poll(self, now: float) -> list[Forwarded]:
        """What time has brought: probes for metadata that is missing."""
        for inlet in self._inlets:
            if inlet.envelope is not None:
                inlet.envelope.poll(now)
        found: list[Forwarded] = []
        for road in self._roads:
            wanted: dict[int, list[int]] = {}
            for key in road.probes.take_due(now):
                publisher, writer_id = key
                living = [w for w in road.catalog.writers(key) if now - w.last_heard < self._timeout]
                if living and isinstance(publisher, int):
                    wanted.setdefault(publisher, []).append(writer_id)
                else:
                    road.probes.settled(key)
            for publisher, ids in wanted.items():
                found += self._probes(road, publisher, sorted(ids))
        return found

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        due = [road.probes.next_deadline() for road in self._roads]
        due += [inlet.envelope.next_deadline() for inlet in self._inlets if inlet.envelope is not None]
        return min((at for at in due if at is not None), default=None)

    def names_of(self, publisher_id: int | str, writer_id: int) -> tuple[str, str] | None:
        """The names of the WriterGroup and the DataSetWriter of an origin, for the topics of a broker."""
        for road in self._roads:
            for writer in road.catalog.writers((publisher_id, writer_id)) if isinstance(publisher_id, int) else ():
                if writer.metadata is not None:
                    return group_name(writer.topic.ns), writer.metadata.name or writer.topic.name
        return None

    def complaints(self, now: float) -> list[Complaint]:
        """What is to be logged of malformed and refused datagrams: each cause at once, then at most once a minute."""
        return self._complaints.take(now)

    def _roads_of(self, connection: int, heard: SecuredDatagram) -> list[_Road]:
        """Where a message may be forwarded to; nowhere, which is counted, for most."""
        publisher = heard.publisher_id
        if heard.publisher_id_type != _UINT16 or not isinstance(publisher, int):
            self._count(heard, Drop.NOT_LISTED)
            return []
        roads = self._by_source.get((connection, publisher), [])
        if not roads:  # what we have sent there ourselves, or who says so
            is_ours = (connection, publisher) in self._by_target
            self._count(heard, Drop.LOOP if is_ours else Drop.NOT_LISTED)
        return roads

    def _count(self, heard: SecuredDatagram, cause: Drop) -> None:
        self._counters.messages_in += len(heard.writer_ids)
        self._counters.drop(cause, max(len(heard.writer_ids), 1))

    def _opened(self, connection: int, datagram: bytes, now: float, *, is_fresh: bool) -> Decoded | None:
        try:
            return self._inlets[connection].read(datagram, now, is_fresh=is_fresh)
        except DatagramRefused as refused:
            self._counters.drop(refused.drop)
            self._complaints.add(refused)
            return None

    def _forward(self, road: _Road, message: Decoded, now: float, *, is_fresh: bool) -> list[Forwarded]:
        if type(message) is NetworkMessage:
            return self._forward_data(road, message, now)
        if isinstance(message, MetaDataAnnouncement):
            self._learn(road, message, is_fresh=is_fresh)
            return []
        if isinstance(message, StatusAnnouncement):
            return [self._said(road, message)]
        return []

    def _learn(self, road: _Road, announcement: MetaDataAnnouncement, *, is_fresh: bool) -> None:
        """Take metadata. It is forwarded with the first message that it describes, which says its WriterGroup too."""
        publisher, writer_id = announcement.publisher_id, announcement.data_set_writer_id
        if not isinstance(publisher, int) or quality_of(announcement.status) is Quality.BAD:
            return
        ids = road.origins.writer_ids(publisher)
        if ids is not None and writer_id not in ids:
            self._counters.drop(Drop.NOT_LISTED)
            return
        key = publisher, writer_id
        # By a relay, what its broker had kept comes as if it were fresh.
        is_fresh = is_fresh and not self._inlets[road.source].relays(publisher)
        if road.catalog.announced(key, announcement.metadata, is_fresh=is_fresh):
            road.probes.answered(key)
        else:
            self._counters.drop(Drop.RETAINED)

    def _forward_data(self, road: _Road, message: NetworkMessage, now: float) -> list[Forwarded]:
        publisher, group = message.publisher_id, message.writer_group_id or 0
        assert isinstance(publisher, int)
        found: list[Forwarded] = []
        parts: list[DataSetMessage] = []
        for part in message.messages:
            if not road.origins.has(publisher, message.writer_group_id, part.data_set_writer_id):
                self._counters.drop(Drop.NOT_LISTED)
            elif not part.valid:
                self._counters.drop(Drop.INVALID)
            elif self._is_described(road, Topic(publisher, group, part.data_set_writer_id), part, now, found):
                parts.append(part if part.timestamp or not message.timestamp else _timed(part, message.timestamp))
        return found + list(self._sent(road, message, parts))

    def _is_described(
        self, road: _Road, topic: Topic, part: DataSetMessage, now: float, found: list[Forwarded]
    ) -> bool:
        """Whether a message's metadata is known, and has been forwarded; it goes into `found` where it has not."""
        writer = self._heard(road, topic, now)
        version = part.major_version, part.minor_version
        if version == (writer.major, writer.minor) and writer.metadata is not None:
            return True
        metadata = road.catalog.find(writer.key, part)
        if metadata is None:
            if (topic.space, topic.id) in self._stated:
                return True
            road.probes.want(writer.key, now)
            self._counters.drop(Drop.NO_METADATA)
            return False
        writer.major, writer.minor = version
        road.probes.settled(writer.key)
        if metadata != writer.metadata:
            writer.metadata = metadata
            found.append(self._said(road, _announcement(writer.topic, metadata)))
        return True

    def _heard(self, road: _Road, topic: Topic, now: float) -> RemoteWriter:
        writer = road.writers.get(topic)
        if writer is None:
            if len(road.writers) >= self._max_writers:
                _, oldest = road.writers.popitem(last=False)
                road.catalog.remove_writer(oldest)
                road.probes.settled(oldest.key)
                road.answered.pop((oldest.topic.space, oldest.topic.id), None)
            writer = road.writers[topic] = RemoteWriter(topic, now, self._counters)
            road.catalog.add_writer(writer)
        else:
            road.writers.move_to_end(topic)
        writer.last_heard = now
        return writer

    def _said(self, road: _Road, announcement: MetaDataAnnouncement | StatusAnnouncement) -> Forwarded:
        """An announcement in the name of its publisher, with a number of ours."""
        self._number = (self._number + 1) & MASK
        return Forwarded(road.target, encode_announcement(announcement._replace(sequence_number=self._number)))

    def _sent(self, road: _Road, message: NetworkMessage, parts: Sequence[DataSetMessage]) -> Iterator[Forwarded]:
        """DataSetMessages in NetworkMessages of our own: the rest of a header is of the connection it came by."""
        if not parts:
            return
        connection = self._connections[road.target]
        head = NetworkMessage(message.publisher_id, _UINT16, writer_group_id=message.writer_group_id)
        whole = None if connection.takes_one and len(parts) > 1 else self._encoded(head, parts)
        if whole is not None and (len(parts) == 1 or len(whole) <= connection.envelope.max_plain_bytes):
            self._counters.messages_out += len(parts)
            yield Forwarded(road.target, whole)
            return
        for part in parts if len(parts) > 1 else ():
            alone = self._encoded(head, (part,))
            if alone is not None:
                self._counters.messages_out += 1
                yield Forwarded(road.target, alone)

    def _encoded(self, head: NetworkMessage, parts: Sequence[DataSetMessage]) -> bytes | None:
        try:
            return self._codec.encode(head._replace(messages=tuple(parts)))
        except LocalWireError:
            if len(parts) == 1:  # of several each is tried alone
                self._counters.drop(Drop.CONVERSION)
            return None

    def _answer(self, connection: int, probe: Probe, now: float) -> list[Forwarded]:
        """Say what is known of an origin to who asks for it, and ask the origin, which says its last values too."""
        publisher = probe.publisher_id
        if probe.kind != ProbeKind.DATA_SET_META_DATA or probe.publisher_id_type != _UINT16:
            return []
        if not isinstance(publisher, int):
            return []
        for road in self._by_source.get((connection, publisher), ()):
            road.probes.asked_by_another(publisher, probe.data_set_writer_ids, now)
        found: list[Forwarded] = []
        for road in self._by_target.get((connection, publisher), ()):
            ids, listed = probe.data_set_writer_ids, road.origins.writer_ids(publisher)
            is_due = now - road.asked.get(publisher, _NEVER) >= ANSWER_INTERVAL_S
            if ids:
                writers = [writer for number in set(ids) for writer in road.catalog.writers((publisher, number))]
            else:  # this goes through all of them, and is free for who asks
                writers = [each for each in road.writers.values() if each.topic.space == publisher] if is_due else []
            for writer in writers:
                key = writer.topic.space, writer.topic.id
                if writer.metadata is not None and now - road.answered.get(key, _NEVER) >= ANSWER_INTERVAL_S:
                    road.answered[key] = now
                    found.append(self._said(road, _announcement(writer.topic, writer.metadata)))
            wanted = set(ids) if listed is None else listed & set(ids or listed)
            if is_due and (wanted or listed is None):
                road.asked[publisher] = now
                found += self._probes(road, publisher, sorted(wanted))
        return found

    def _probes(self, road: _Road, publisher: int, ids: Sequence[int]) -> list[Forwarded]:
        """Probes for the metadata of DataSetWriters of a publisher; with no ids for that of all."""
        found: list[Forwarded] = []
        for start in range(0, max(len(ids), 1), IDS_IN_PROBE):
            part = tuple(ids[start : start + IDS_IN_PROBE])
            probe = Probe(publisher, _UINT16, ProbeKind.DATA_SET_META_DATA.value, part)
            found.append(Forwarded(road.source, encode_probe(probe)))
        return found


def _announcement(topic: Topic, metadata: DataSetMetaData) -> MetaDataAnnouncement:
    return MetaDataAnnouncement(topic.space, _UINT16, 0, topic.id, metadata)


def _timed(part: DataSetMessage, timestamp: int) -> DataSetMessage:
    """A message that has its time in the header of the NetworkMessage."""
    return part._replace(timestamp=timestamp)
