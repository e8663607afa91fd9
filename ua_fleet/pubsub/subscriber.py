"""The DataSetReaders of one process: datagrams in, facts out. What is dropped is counted by its cause.

A datagram is opened first, where there is an envelope: what is refused there reaches none of the following. A
DataSetMessage passes these gates in this order: the loop rule, a legal source, the valid flag, the sequence of its
writer, the Timestamp, metadata of its version, and the types of its fields.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping
from itertools import count
from random import Random
from types import MappingProxyType
from typing import Any, Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import RemoteWireError, TopicInvalid
from ua_fleet.pubsub.catalog import Catalog
from ua_fleet.pubsub.complaints import Complaint, Complaints
from ua_fleet.pubsub.events import (
    ActionReceived,
    AnnouncementReceived,
    DataReceived,
    MetaDataReceived,
    ProbeDue,
    ProbeReceived,
    SourceRefused,
    SourceReturned,
    SourceSilent,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.frames import merge_delta, types_fit
from ua_fleet.pubsub.metadata import type_codes
from ua_fleet.pubsub.probing import ProbeSchedule
from ua_fleet.pubsub.remote_writer import NO_COMMUNICATION, RemoteWriter, Step
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.refused import Refused
from ua_fleet.pubsub.sequence import MASK
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.pubsub.wishes import IDS_IN_PROBE, Wishes
from ua_fleet.topics import Side, Topic, Verdict, loop_verdict
from ua_fleet.values import Quality, quality_of
from ua_fleet.wire import Codec, SecuredMessage, decode_raw_fields, encode_probe
from ua_fleet.wire.actions import ActionMessage
from ua_fleet.wire.discovered import AnyAnnouncement
from ua_fleet.wire.messages import (
    DataSetMessage,
    FieldEncoding,
    FrameKind,
    MetaDataAnnouncement,
    NetworkMessage,
    Probe,
    ProbeKind,
    PublisherIdType,
)
from ua_fleet.wire.security import SecurityMode

__all__ = ["LoopRule", "Subscriber"]

LoopRule = Callable[[Side, int, int, bool], Verdict]
"""`topics.loop_verdict`, or what a test puts in its place."""

_MOST_REFUSED: Final = 1024
"""Refused sources that we have told of. Anybody can write any PublisherId and DataSetWriterId."""
_UINT16: Final = PublisherIdType.UINT16.value
_KEY: Final = FrameKind.KEY.value
_DELTA: Final = FrameKind.DELTA.value
_KEEP_ALIVE: Final = FrameKind.KEEP_ALIVE.value
_VARIANT: Final = FieldEncoding.VARIANT.value
_RAW: Final = FieldEncoding.RAW_DATA.value


class Subscriber:
    """All DataSetReaders of one process. It never raises on a datagram."""

    def __init__(
        self,
        own_space: int,
        timing: PubSubTiming,
        counters: Counters,
        codec: Codec,
        rule: LoopRule = loop_verdict,
        *,
        envelope: Envelope | None = None,
        max_writers: int = 50_000,
        random: Random | None = None,
    ) -> None:
        """Make a subscriber that knows no writers.

        Args:
            own_space: the space whose data comes back to us by multicast and is dropped; 0 for the server.
            timing: MessageReceiveTimeout stands here.
            counters: what is received and dropped is counted here.
            codec: the process's codec.
            rule: the loop rule.
            envelope: opens what is received; without one, what is secured or a chunk is dropped.
            max_writers: most writers to know. Beyond, the longest silent one is forgotten; while all of them live, what
                others send is counted as of an unknown source.
            random: where the random delay of probes comes from.
        """
        self._own_space = own_space
        self._timeout = timing.receive_timeout_s
        self._counters = counters
        self._codec = codec
        self._rule = rule
        self._envelope = envelope
        self._refused: dict[tuple[int, int, int], None] = {}
        """Sources told of as refused, the longest known first."""
        self._verdicts: dict[int, bool] = {}
        self._max_writers = max_writers
        self._writers: dict[tuple[int, int | None, int], RemoteWriter] = {}
        self._catalog = Catalog(max_writers)
        random = random or Random()  # noqa: S311 - spreads probes, keeps no secret
        self._probes = ProbeSchedule(random)
        self._wishes = Wishes(random)
        self._silences: list[tuple[float, int, RemoteWriter]] = []
        self._silent: dict[RemoteWriter, None] = {}
        """The longest silent first."""
        self._order = count()
        self._complaints = Complaints()

    @property
    def writers(self) -> Mapping[Any, RemoteWriter]:
        """The writers that were heard, by Topic, with their statistics; a live view."""
        return MappingProxyType(self._writers)

    def receive(self, datagram: bytes, now: float, sender: tuple[str, int] | None = None) -> list[SubscriberEvent]:
        """Take one datagram, and where it came from: a request may be answered there."""
        try:
            if self._envelope is not None:
                plain = self._envelope.open(datagram, now)
                if plain is None:
                    return []
                datagram = plain
            message = self._codec.decode(datagram)
        except Refused as refused:
            return self._refuse(refused)
        except SecuredMessage:
            self._counters.drop(Drop.SECURED)
            return []
        except RemoteWireError as error:
            self._count_malformed(error)
            return []
        if type(message) is NetworkMessage:
            return self._receive_data(message, now)
        if isinstance(message, Probe):
            return self._receive_probe(message, now)
        if isinstance(message, ActionMessage):
            return self._receive_action(message, sender)
        return [] if isinstance(message, NetworkMessage) else self._receive_announcement(message)

    def known(self, topic: Topic) -> list[SubscriberEvent]:
        """What was heard of a source last, for one who begins to follow it now."""
        writer = self._writers.get(topic)
        if writer is None or writer.metadata is None:
            return []
        events: list[SubscriberEvent] = [MetaDataReceived(topic, writer.metadata)]
        if writer.last_frame is not None:
            events.append(DataReceived(topic, writer.last_frame, writer.metadata))
        if writer.silent:
            events.append(SourceSilent(topic))
        return events

    def want_action(self, publisher_id: int, data_set_writer_id: int, now: float) -> bool:
        """Ask for the Actions of a DataSetWriter until they are announced; False if there are too many wishes.

        What is announced comes as AnnouncementReceived, the probes as ProbeDue.
        """
        return self._wishes.want_action(publisher_id, data_set_writer_id, now)

    def want(self, publisher_id: int, kind: ProbeKind, now: float) -> bool:
        """Ask a Publisher for its endpoints, connections or DataSetWriters, as `want_action` does for Actions."""
        return self._wishes.want(publisher_id, kind, now)

    def poll(self, now: float) -> list[SubscriberEvent]:
        """What time has brought: silent sources and probes that are due."""
        events: list[SubscriberEvent] = []
        if self._envelope is not None:
            self._envelope.poll(now)
        silences = self._silences
        while silences and silences[0][0] <= now:
            _, order, writer = silences[0]
            deadline = writer.last_heard + self._timeout
            if deadline > now:
                heapq.heapreplace(silences, (deadline, order, writer))
                continue
            heapq.heappop(silences)
            if writer.metadata is None:
                self._forget(writer)
            else:
                writer.silent = True
                self._silent[writer] = None
                events.append(SourceSilent(writer.topic))
        self._probe(self._probes.take_due(now), events)
        events += map(ProbeDue, self._wishes.take_due(now))
        return events

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None. It may have nothing to say then."""
        due = self._probes.next_deadline()
        wish = self._wishes.next_deadline()
        if wish is not None:
            due = wish if due is None else min(due, wish)
        if self._silences:
            silence = self._silences[0][0]
            due = silence if due is None else min(due, silence)
        if self._envelope is not None:
            chunks = self._envelope.next_deadline()
            if chunks is not None:
                return chunks if due is None else min(due, chunks)
        return due

    def complaints(self, now: float) -> list[Complaint]:
        """What is to be logged of malformed and refused datagrams: each cause at once, then at most once a minute."""
        return self._complaints.take(now)

    def _receive_data(self, message: NetworkMessage, now: float) -> list[SubscriberEvent]:
        parts = message.messages
        self._counters.messages_in += len(parts)
        publisher_id = message.publisher_id
        if message.publisher_id_type != _UINT16 or type(publisher_id) is not int:
            self._counters.drop(Drop.UNKNOWN_SOURCE, len(parts))
            return []
        if not (self._verdicts.get(publisher_id) or self._comes_in(publisher_id)):
            self._counters.drop(Drop.LOOP, len(parts))
            return []
        events: list[SubscriberEvent] = []
        group_id = message.writer_group_id
        for part in parts:
            if not part.valid:
                self._counters.drop(Drop.INVALID)
                continue
            writer = self._writers.get((publisher_id, group_id, part.data_set_writer_id))
            if writer is None:
                writer = self._meet(publisher_id, group_id, part.data_set_writer_id, now)
                if writer is None:
                    self._counters.drop(Drop.UNKNOWN_SOURCE)
                    continue
            if part.kind == _KEEP_ALIVE:
                self._receive_keep_alive(writer, part, now, events)
            else:
                if part.timestamp is None and message.timestamp:
                    part = part._replace(timestamp=message.timestamp)
                self._receive_frame(writer, part, now, events)
        return events

    def _receive_frame(
        self, writer: RemoteWriter, frame: DataSetMessage, now: float, events: list[SubscriberEvent]
    ) -> None:
        number = frame.sequence_number
        timestamp = frame.timestamp
        if number is not None and number == writer.expected:
            writer.expected = (number + 1) & MASK
            if timestamp is not None and timestamp > writer.heard_timestamp:
                writer.heard_timestamp = timestamp
        elif (step := writer.follow(frame, now, self._timeout)) is not Step.TAKEN:
            self._counters.drop(Drop.LATE if step is Step.LATE else Drop.DUPLICATE)
            return
        is_new = timestamp is None or timestamp > writer.handed_on or writer.is_new(timestamp, now, self._timeout)
        if is_new or (frame.status or 0) >> 16 != NO_COMMUNICATION:  # repeated, that one attests nothing
            writer.last_heard = now
            if writer.silent:
                self._attest(writer, now, events)
        if (frame.major_version != writer.major or frame.minor_version != writer.minor) and not self._bind(
            writer, frame, now, events
        ):
            self._counters.drop(Drop.NO_METADATA)
            return
        writer.received += 1
        if not is_new:
            writer.confirm(number)
            self._counters.drop(Drop.REPEATED)
            return
        if frame.kind != _KEY or frame.encoding != _VARIANT or frame.types != writer.types:
            checked = self._check(writer, frame, now)
            if checked is None:
                return
            frame = checked
        writer.hand_on(frame)
        assert writer.metadata is not None
        events.append(DataReceived(writer.topic, frame, writer.metadata))

    def _check(self, writer: RemoteWriter, frame: DataSetMessage, now: float) -> DataSetMessage | None:
        """The key frame that a frame of any form stands for; None, after counting why, if there is none."""
        metadata = writer.metadata
        assert metadata is not None
        if frame.kind not in (_KEY, _DELTA):
            self._counters.drop(Drop.UNSUPPORTED)
            return None
        if frame.encoding == _RAW:
            try:
                frame = decode_raw_fields(frame, metadata)
            except RemoteWireError as error:
                self._count_malformed(error)
                return None
        if frame.kind == _DELTA:
            base = writer.base_of(frame)
            if base is None:
                self._counters.drop(Drop.NO_KEY_FRAME)
                return None
            merged = merge_delta(base, frame)
            if merged is None:
                self._counters.drop(Drop.LAYOUT)
                return None
            frame = merged
        elif not frame.types and metadata.fields:  # a heartbeat (OPC 10000-14 5.3.3)
            writer.confirm(frame.sequence_number)
            return None
        if frame.types != writer.types and not types_fit(frame.types, metadata.fields):
            self._counters.drop(Drop.LAYOUT)
            self._probes.want(writer.key, now)  # it may be the metadata that is wrong
            return None
        return frame

    def _receive_keep_alive(
        self, writer: RemoteWriter, message: DataSetMessage, now: float, events: list[SubscriberEvent]
    ) -> None:
        if not writer.follow_keep_alive(message, now, self._timeout):
            writer.duplicates += 1
            self._counters.drop(Drop.DUPLICATE)
            return
        writer.received += 1
        self._attest(writer, now, events)
        if message.major_version != writer.major or message.minor_version != writer.minor:
            self._bind(writer, message, now, events)

    def _receive_announcement(self, announcement: AnyAnnouncement) -> list[SubscriberEvent]:
        publisher_id = announcement.publisher_id
        if announcement.publisher_id_type != _UINT16 or not isinstance(publisher_id, int):
            self._counters.drop(Drop.UNKNOWN_SOURCE)
            return []
        if not self._comes_in(publisher_id):
            self._counters.drop(Drop.LOOP)
            return []
        self._wishes.heard(announcement)
        if not isinstance(announcement, MetaDataAnnouncement):
            return [AnnouncementReceived(announcement)]
        key = (publisher_id, announcement.data_set_writer_id)
        if quality_of(announcement.status) is not Quality.BAD:  # otherwise there is no such writer (7.2.4.6.4)
            self._catalog.announced(key, announcement.metadata)
        self._probes.answered(key)
        return []

    def _receive_probe(self, probe: Probe, now: float) -> list[SubscriberEvent]:
        publisher_id = probe.publisher_id
        if probe.kind == ProbeKind.FIND_APPLICATIONS:
            return [ProbeReceived(probe)]
        if probe.publisher_id_type != _UINT16 or not isinstance(publisher_id, int):
            return []
        if publisher_id == self._own_space:
            return [ProbeReceived(probe)]
        self._wishes.asked_by_another(probe, now)
        if probe.kind == ProbeKind.DATA_SET_META_DATA:
            self._probes.asked_by_another(publisher_id, probe.data_set_writer_ids, now)
        return []

    def _receive_action(self, message: ActionMessage, sender: tuple[str, int] | None) -> list[SubscriberEvent]:
        """Hand on requests to us, and responses to anybody but us: multicast brings those of others too."""
        is_ours = message.publisher_id_type == _UINT16 and message.publisher_id == self._own_space
        if message.is_request is not is_ours:
            return []
        self._counters.messages_in += 1 + len(message.others)
        verified = self._envelope is not None and self._envelope.mode is not SecurityMode.NONE
        return [ActionReceived(message, sender, verified)]

    def _refuse(self, refused: Refused) -> list[SubscriberEvent]:
        """Count a message that was refused. Only a source that is not heard is told of: nothing in it is proved."""
        drop, writer_ids = refused.drop, refused.writer_ids
        if drop is Drop.LOOP:
            self._counters.messages_in += len(writer_ids)
            self._counters.drop(drop, len(writer_ids) or 1)
            return []
        self._counters.drop(drop)
        self._complaints.add(refused)
        publisher_id, group_id = refused.publisher_id, refused.writer_group_id
        if refused.is_action or drop is Drop.UNKNOWN_SOURCE or type(publisher_id) is not int or group_id is None:
            return []
        events: list[SubscriberEvent] = []
        for writer_id in writer_ids:
            key = (publisher_id, group_id, writer_id)
            writer = self._writers.get(key)
            if key in self._refused or (writer is not None and not writer.silent):
                continue
            try:
                topic = Topic.checked(*key)
            except TopicInvalid:
                continue
            if len(self._refused) >= _MOST_REFUSED:
                del self._refused[next(iter(self._refused))]
            self._refused[topic] = None
            events.append(SourceRefused(topic, drop))
        return events

    def _comes_in(self, publisher_id: int) -> bool:
        """What the loop rule says to a publisher; it is asked once for each."""
        known = self._verdicts.get(publisher_id)
        if known is None:
            verdict = self._rule(Side.PUBSUB, publisher_id, self._own_space, False)
            known = self._verdicts[publisher_id] = verdict is Verdict.TO_SPACE
        return known

    def _meet(self, publisher_id: int, group_id: int | None, writer_id: int, now: float) -> RemoteWriter | None:
        """Begin to know a writer; None if it is no legal source, or one too many."""
        try:
            topic = Topic.checked(publisher_id, group_id or 0, writer_id)
        except TopicInvalid:
            return None
        if len(self._writers) >= self._max_writers:
            if not self._silent:
                return None
            self._forget(next(iter(self._silent)))
        self._refused.pop(topic, None)
        writer = self._writers[topic] = RemoteWriter(topic, now, self._counters)
        self._catalog.add_writer(writer)
        self._watch(writer)
        return writer

    def _forget(self, writer: RemoteWriter) -> None:
        """Forget a silent writer: one that never said what it sends, or the longest silent where there are too many."""
        del self._writers[writer.topic]
        self._silent.pop(writer, None)
        self._catalog.remove_writer(writer)
        self._probes.settled(writer.key)

    def _watch(self, writer: RemoteWriter) -> None:
        heapq.heappush(self._silences, (writer.last_heard + self._timeout, next(self._order), writer))

    def _attest(self, writer: RemoteWriter, now: float, events: list[SubscriberEvent]) -> None:
        writer.last_heard = now
        if writer.silent:
            writer.silent = False
            self._refused.pop(writer.topic, None)
            del self._silent[writer]
            self._watch(writer)
            events.append(SourceReturned(writer.topic))

    def _bind(self, writer: RemoteWriter, message: DataSetMessage, now: float, events: list[SubscriberEvent]) -> bool:
        """Find the metadata of a message's version; if it is not known, see to it that it is probed for."""
        metadata = self._catalog.find(writer.key, message)
        if metadata is None:
            self._probes.want(writer.key, now)
            return False
        writer.major, writer.minor = message.major_version, message.minor_version
        if message.major_version is not None:
            writer.heard_major = message.major_version
        self._probes.settled(writer.key)
        before = writer.metadata
        if metadata != before:
            if before is None or before.fields != metadata.fields:
                writer.last_frame = None
                writer.types = type_codes(metadata.fields)
            writer.metadata = metadata
            events.append(MetaDataReceived(writer.topic, metadata))
        return True

    def _probe(self, keys: list[tuple[int, int]], events: list[SubscriberEvent]) -> None:
        """Probe for what is not known; one probe asks a publisher for many writers."""
        asked: dict[int, list[RemoteWriter]] = {}
        for key in keys:
            living = [writer for writer in self._catalog.writers(key) if not writer.silent]
            if living:
                asked.setdefault(key[0], []).extend(living)
            else:
                self._probes.settled(key)
        for publisher_id, writers in asked.items():
            for start in range(0, len(writers), IDS_IN_PROBE):
                part = writers[start : start + IDS_IN_PROBE]
                ids = tuple(sorted({writer.topic.id for writer in part}))
                datagram = encode_probe(Probe(publisher_id, _UINT16, ProbeKind.DATA_SET_META_DATA.value, ids))
                for writer in part:
                    events.append(SourceUnknown(writer.topic, datagram))
                    datagram = b""

    def _count_malformed(self, error: RemoteWireError) -> None:
        self._counters.drop_malformed(error.cause)
        self._complaints.add(error)
