"""The DataSetReaders of one process: datagrams in, facts out. What is dropped is counted by its cause.

A datagram is opened first, where there is an envelope: what is refused there reaches none of the following. A
DataSetMessage passes these gates in this order: the loop rule, a legal source, the valid flag, the sequence of its
writer, the Timestamp, metadata of its version, and the types of its fields. Only what passes all of them, or repeats
what did, says that a value is of now.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
    EventReceived,
    MetaDataReceived,
    ProbeDue,
    ProbeReceived,
    SetpointReceived,
    SourceRefused,
    SourceSilent,
    SourceStale,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.frames import merge_delta, types_fit
from ua_fleet.pubsub.liveness import Liveness
from ua_fleet.pubsub.mapped import MappedSources, PublisherKey, publisher_key
from ua_fleet.pubsub.metadata import max_age_s, type_codes, with_max_age
from ua_fleet.pubsub.probing import ProbeSchedule
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.pubsub.remote_writer import RemoteWriter, SequenceStep
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.pubsub.sequence import MASK
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.pubsub.wishes import IDS_IN_PROBE, Wishes
from ua_fleet.topics import SERVER_SPACE, LoopVerdict, Side, Topic, loop_verdict
from ua_fleet.values import Quality, quality_of
from ua_fleet.wire import Codec, SecuredMessage, decode_raw_fields, encode_probe
from ua_fleet.wire.actions import ActionMessage
from ua_fleet.wire.discovered import AnyAnnouncement
from ua_fleet.wire.messages import (
    DataSetMessage,
    DataSetMetaData,
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

LoopRule = Callable[[Side, int, int, bool], LoopVerdict]
"""`topics.loop_verdict`, or what a test puts in its place."""

_MOST_REFUSED: Final = 1024
"""Refused sources that we have told of. Anybody can write any PublisherId and DataSetWriterId."""
_COUNT_AFTER: Final = 2
"""Where the number of DataSetMessages of a data message of ours stands, behind its GroupFlags."""
_UINT16: Final = PublisherIdType.UINT16.value
_KEY: Final = FrameKind.KEY.value
_DELTA: Final = FrameKind.DELTA.value
_EVENT: Final = FrameKind.EVENT.value
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
        max_ages: Mapping[Topic, float] | None = None,
        mapped: MappedSources | None = None,
        setpoint_groups: Mapping[int, int] | None = None,
        publisher_ids: PublisherIds | None = None,
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
            max_ages: maximum ages in seconds of the values of writers that announce none themselves.
            mapped: DataSetWriters of publishers that are no bridges.
            setpoint_groups: spaces by the WriterGroups of the server's setpoints for them.
            publisher_ids: of spaces that have another PublisherId on the wire; the envelope has them too.
            random: where the random delay of probes comes from.
        """
        self.caught: Callable[[str, Exception], None] | None = None
        """Told of a mistake that cost one writer what time has brought it; without it, the mistake is raised."""
        self.opened: Callable[[bytes], None] | None = None
        """Told of each plain message before it is decoded; for who looks at messages."""
        self.is_nearer = True
        """Whether the last datagram may have brought the next deadline nearer. A new value of a writer that is heard
        all the time, and a chunk of a message, do not: chunks that do not come are given up after seconds."""
        self.impostor: Callable[[tuple[str, int], float], bool] | None = None
        """Told who has sent a message with our PublisherId, and when; whether that is somebody else."""
        self._own_space = own_space
        self._timeout = timing.receive_timeout_s
        self._counters = counters
        self._codec = codec
        self._rule = rule
        self._envelope = envelope
        self._refused: dict[tuple[int, int, int], None] = {}
        """Sources told of as refused, the longest known first."""
        self._verdicts: dict[int, bool] = {}
        own = own_space.to_bytes(2, "little") if own_space >= 0 else b""
        heads = (b"\xf1\x01" + own + b"\x01", b"\xf1\x11" + own + b"\x01") if own else ()
        self._own_heads = tuple([head if publisher_ids is None else publisher_ids.outward(head) for head in heads])
        """How the data that we send ourselves begins: it comes back by multicast, and is dropped unread. A tool has no
        space, and sends none."""
        self._max_writers = max_writers
        self._max_ages = max_ages or {}
        self._mapped = mapped or MappedSources()
        self._setpoint_groups = setpoint_groups or {}
        self._writers: dict[tuple[int, int | None, int], RemoteWriter] = {}
        self._catalog = Catalog(max_writers)
        random = random or Random()  # noqa: S311 - spreads probes, keeps no secret
        self._probes = ProbeSchedule(random)
        self._wishes = Wishes(random)
        self._liveness = Liveness(self._timeout)
        self._complaints = Complaints()

    @property
    def writers(self) -> Mapping[Any, RemoteWriter]:
        """The writers that were heard, by Topic, with their statistics; a live view."""
        return MappingProxyType(self._writers)

    def receive(self, datagram: bytes, now: float, sender: tuple[str, int] | None = None) -> list[SubscriberEvent]:
        """Take one datagram, and where it came from: a request may be answered there."""
        self.is_nearer = True
        if datagram.startswith(self._own_heads) and not self._comes_in(self._own_space):
            count_at = _COUNT_AFTER + next(len(head) for head in self._own_heads if datagram.startswith(head))
            if len(datagram) > count_at:
                self._counters.messages_in += datagram[count_at]
                self._counters.drop(self._cause_of_own(datagram, sender, now), datagram[count_at])
                return []
        try:
            if self._envelope is not None:
                plain = self._envelope.open(datagram, now)
                if plain is None:
                    self.is_nearer = False
                    return []
                datagram = plain
            if self.opened is not None:
                self.opened(datagram)
            message = self._codec.decode(datagram)
        except DatagramRefused as refused:
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

    def _cause_of_own(self, datagram: bytes, sender: tuple[str, int] | None, now: float) -> Drop:
        """Whether a message with our PublisherId came back to us, or is another process's that has our keys."""
        if sender is None or self.impostor is None:
            return Drop.LOOP
        if self._envelope is not None and not self._envelope.is_of_another(datagram, now):
            return Drop.LOOP
        return Drop.CONFLICT if self.impostor(sender, now) else Drop.LOOP

    def known(self, topic: Topic) -> list[SubscriberEvent]:
        """What was heard of a source last, for one who begins to follow it now."""
        writer = self._writers.get(topic)
        if writer is None or writer.metadata is None:
            return []
        events: list[SubscriberEvent] = [MetaDataReceived(topic, writer.metadata)]
        if writer.last_frame is not None:
            events.append(DataReceived(topic, writer.last_frame, writer.metadata))
        if writer.silent or writer.stale:
            events.append(SourceSilent(topic) if writer.silent else SourceStale(topic))
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
        # What is due in one of them is lost by a mistake there, and in no other.
        for step in (self._poll_envelope, self._poll_liveness, self._poll_probes):
            try:
                step(now, events)
            except Exception as error:
                if self.caught is None:
                    raise
                self.caught("silences", error)
        return events

    def _poll_envelope(self, now: float, _events: list[SubscriberEvent]) -> None:
        if self._envelope is not None:
            self._envelope.poll(now)

    def _poll_liveness(self, now: float, events: list[SubscriberEvent]) -> None:
        found, nameless = self._liveness.poll(now, self.caught)
        events += found
        for writer in nameless:
            self._forget(writer)

    def _poll_probes(self, now: float, events: list[SubscriberEvent]) -> None:
        self._probe(self._probes.take_due(now), now, events)
        events += map(ProbeDue, self._wishes.take_due(now))

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None. It may have nothing to say then."""
        due = self._probes.next_deadline()
        wish = self._wishes.next_deadline()
        if wish is not None:
            due = wish if due is None else min(due, wish)
        silence = self._liveness.next_deadline()
        if silence is not None:
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
        events: list[SubscriberEvent] = []
        if self._mapped:
            parts = self._receive_mapped(message, now, events)
            if not parts:
                self.is_nearer = True
                return events
        if message.publisher_id_type != _UINT16 or type(publisher_id) is not int:
            self._counters.drop(Drop.UNKNOWN_SOURCE, len(parts))
            self._complaints.add_unknown(message)
            return events
        if not (self._verdicts.get(publisher_id) or self._comes_in(publisher_id)):
            self._counters.drop(Drop.LOOP, len(parts))
            return events
        group_id = message.writer_group_id
        if publisher_id == SERVER_SPACE and group_id is not None and group_id in self._setpoint_groups:
            return self._receive_setpoints(group_id, parts)
        for part in parts:
            writer = self._writers.get((publisher_id, group_id, part.data_set_writer_id))
            if writer is None and part.valid:
                writer = self._meet(publisher_id, group_id, part.data_set_writer_id, now)
                if writer is None:
                    self._counters.drop(Drop.UNKNOWN_SOURCE)
                    self._complaints.add_unknown(message)
                    continue
            self._receive_part(writer, part, message.timestamp, now, events)
        if len(message.messages) != 1:  # the last one does not speak for the others
            self.is_nearer = True
        return events

    def _receive_setpoints(self, group_id: int, parts: tuple[DataSetMessage, ...]) -> list[SubscriberEvent]:
        """Hand on setpoints for us; on multicast everybody hears those for others."""
        if self._setpoint_groups[group_id] != self._own_space:
            return []
        return [SetpointReceived(group_id, part) for part in parts]

    def _receive_part(
        self,
        writer: RemoteWriter | None,
        part: DataSetMessage,
        timestamp: int | None,
        now: float,
        events: list[SubscriberEvent],
    ) -> None:
        if writer is None or not part.valid:
            self._counters.drop(Drop.INVALID)
            if writer is not None:
                writer.doubted = True
        elif part.kind == _KEEP_ALIVE:
            self._receive_keep_alive(writer, part, now, events)
        else:
            if part.timestamp is None and timestamp:
                part = part._replace(timestamp=timestamp)
            self._receive_frame(writer, part, now, events)

    def _receive_mapped(
        self, message: NetworkMessage, now: float, events: list[SubscriberEvent]
    ) -> tuple[DataSetMessage, ...]:
        """Take what `sources` of `fleet.yaml` names; the rest of the message, which it does not."""
        publisher_id, group_id = message.publisher_id, message.writer_group_id
        if publisher_id is None:
            return message.messages
        publisher = publisher_key(message.publisher_id_type, publisher_id)
        rest: list[DataSetMessage] = []
        for part in message.messages:
            source = self._mapped.find(publisher, group_id, part.data_set_writer_id)
            if source is None:
                if (publisher, group_id, part.data_set_writer_id) in self._mapped.topics:
                    self._counters.drop(Drop.CONFLICT)  # the address is that of a source that others send
                else:
                    rest.append(part)
            elif not self._comes_in(source.topic.space):
                self._counters.drop(Drop.LOOP)
            else:
                writer = self._writers.get(source.topic)
                if writer is None and part.valid:
                    writer = self._know(source.topic, now, (publisher, part.data_set_writer_id), source.metadata)
                    if writer is None:
                        self._counters.drop(Drop.UNKNOWN_SOURCE)
                        continue
                self._receive_part(writer, part, message.timestamp, now, events)
        return tuple(rest)

    def _receive_frame(
        self, writer: RemoteWriter, frame: DataSetMessage, now: float, events: list[SubscriberEvent]
    ) -> None:
        number = frame.sequence_number
        timestamp = frame.timestamp
        if number is not None and number == writer.expected:
            writer.expected = (number + 1) & MASK
            if timestamp is not None and timestamp > writer.heard_timestamp:
                writer.heard_timestamp = timestamp
        elif (step := writer.follow(frame, now, self._timeout)) is not SequenceStep.TAKEN:
            self._counters.drop(Drop.LATE if step is SequenceStep.LATE else Drop.DUPLICATE)
            return
        writer.last_heard = now
        is_new = timestamp is None or timestamp > writer.handed_on or writer.is_new(timestamp, now, self._timeout)
        if (frame.major_version != writer.major or frame.minor_version != writer.minor) and not self._bind(
            writer, frame, now, events
        ):
            writer.doubted = True
            self._counters.drop(Drop.NO_METADATA)
            return
        writer.received += 1
        if frame.kind == _EVENT:
            self._receive_event(writer, frame, is_new or number is not None, now, events)
            return
        if not is_new:
            self._counters.drop(Drop.REPEATED)
            if writer.repeats(frame):
                self._attest(writer, now, events)
            elif number is None:  # a keep-alive after it has no number either that would tell of it
                writer.doubted = True
            return
        if frame.kind != _KEY or frame.encoding != _VARIANT or frame.types != writer.types:
            if frame.kind == _KEY and frame.encoding != _RAW and not frame.types and writer.types:
                self._receive_heartbeat(writer, number, now, events)
                return
            checked = self._check(writer, frame, now)
            if checked is None:
                writer.doubted = True
                return
            frame = checked
        is_first = not writer.has_said
        writer.hand_on(frame)
        writer.alive_at = writer.attested_at = writer.said_at = now
        if writer.silent or writer.stale:
            self._attest(writer, now, events)
        elif is_first and writer.max_age_s is not None:
            self._liveness.add(writer)
        else:
            self.is_nearer = bool(events)  # its metadata, with a maximum age
        assert writer.metadata is not None
        events.append(DataReceived(writer.topic, frame, writer.metadata))

    def _receive_event(
        self, writer: RemoteWriter, event: DataSetMessage, is_new: bool, now: float, events: list[SubscriberEvent]
    ) -> None:
        """Hand on an event. Several may have one Timestamp: that the number is new has been seen.

        A DataSetWriter sends events or values (6.2.4.3): what has said a value is not attested by an event.
        """
        if writer.has_said:
            self._counters.drop(Drop.UNSUPPORTED)
            writer.doubted = True
            return
        if not is_new:
            self._counters.drop(Drop.REPEATED)
            return
        metadata = writer.metadata
        assert metadata is not None
        if event.types != writer.types and not types_fit(event.types, metadata.fields):
            self._counters.drop(Drop.LAYOUT)
            self._probes.want(writer.key, now)
            return
        if event.timestamp is not None:
            writer.handed_on = max(writer.handed_on, event.timestamp)
        self._attest(writer, now, events)
        events.append(EventReceived(writer.topic, event, metadata))

    def _receive_heartbeat(
        self, writer: RemoteWriter, number: int | None, now: float, events: list[SubscriberEvent]
    ) -> None:
        """Take a key frame without fields (OPC 10000-14 5.3.3): it says what a keep-alive says."""
        if writer.is_sure(number):
            writer.confirm(number)
            self._attest(writer, now, events)
        else:
            self._liveness.live(writer, now, events)

    def _check(self, writer: RemoteWriter, frame: DataSetMessage, now: float) -> DataSetMessage | None:
        """The key frame that a frame of any form stands for; None, after counting why, if there is none."""
        metadata = writer.metadata
        assert metadata is not None
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
                self._probes.want(writer.key, now)  # who is asked says its last message again, as a key frame
                return None
            merged = merge_delta(base, frame)
            if merged is None:
                self._counters.drop(Drop.LAYOUT)
                return None
            frame = merged
        if frame.types != writer.types and not types_fit(frame.types, metadata.fields):
            self._counters.drop(Drop.LAYOUT)
            self._probes.want(writer.key, now)  # it may be the metadata that is wrong
            return None
        return frame

    def _receive_keep_alive(
        self, writer: RemoteWriter, message: DataSetMessage, now: float, events: list[SubscriberEvent]
    ) -> None:
        gaps = writer.gaps
        if not writer.follow_keep_alive(message, now, self._timeout):
            writer.duplicates += 1
            self._counters.drop(Drop.DUPLICATE)
            return
        writer.received += 1
        writer.last_heard = now
        if (message.major_version != writer.major or message.minor_version != writer.minor) and not self._bind(
            writer, message, now, events
        ):
            if not writer.has_said:
                self._attest(writer, now, events)
            return
        if writer.is_sure(message.sequence_number) and not writer.is_of_another_version(message):
            self._attest(writer, now, events)
            return
        self._liveness.live(writer, now, events)
        if writer.gaps != gaps:
            self._probes.want(writer.key, now)  # who is asked says its last message again

    def _receive_announcement(self, announcement: AnyAnnouncement) -> list[SubscriberEvent]:
        publisher_id = announcement.publisher_id
        if publisher_id is None:
            self._counters.drop(Drop.UNKNOWN_SOURCE)
            return []
        publisher = publisher_key(announcement.publisher_id_type, publisher_id)
        if not isinstance(publisher, int):
            if not self._mapped.knows(publisher) or not isinstance(announcement, MetaDataAnnouncement):
                self._counters.drop(Drop.UNKNOWN_SOURCE)
                return []
        elif not self._comes_in(publisher):
            self._counters.drop(Drop.LOOP)
            return []
        self._wishes.heard(announcement)
        if not isinstance(announcement, MetaDataAnnouncement):
            return [AnnouncementReceived(announcement)]
        key = (publisher, announcement.data_set_writer_id)
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

    def _refuse(self, refused: DatagramRefused) -> list[SubscriberEvent]:
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
            known = self._verdicts[publisher_id] = verdict is LoopVerdict.TO_SPACE
        return known

    def _meet(self, publisher_id: int, group_id: int | None, writer_id: int, now: float) -> RemoteWriter | None:
        """Begin to know a writer; None if it is no legal source, or one too many."""
        try:
            topic = Topic.checked(publisher_id, group_id or 0, writer_id)
        except TopicInvalid:
            return None
        return self._know(topic, now)

    def _know(
        self,
        topic: Topic,
        now: float,
        key: tuple[PublisherKey, int] | None = None,
        stated: DataSetMetaData | None = None,
    ) -> RemoteWriter | None:
        """Begin to know a writer, a mapped one with its own name and what is stated of it; None if one too many."""
        if len(self._writers) >= self._max_writers:
            oldest = self._liveness.longest_silent
            if oldest is None:
                return None
            self._forget(oldest)
        self._refused.pop(topic, None)
        writer = self._writers[topic] = RemoteWriter(topic, now, self._counters)
        if key is not None:
            writer.key, writer.stated = key, stated
        self._catalog.add_writer(writer)
        self._liveness.add(writer)
        return writer

    def _forget(self, writer: RemoteWriter) -> None:
        """Forget a silent writer: one that never said what it sends, or the longest silent where there are too many."""
        del self._writers[writer.topic]
        self._liveness.forget(writer)
        self._catalog.remove_writer(writer)
        self._probes.settled(writer.key)

    def _attest(self, writer: RemoteWriter, now: float, events: list[SubscriberEvent]) -> None:
        if writer.silent:
            self._refused.pop(writer.topic, None)
        self._liveness.attest(writer, now, events)

    def _bind(self, writer: RemoteWriter, message: DataSetMessage, now: float, events: list[SubscriberEvent]) -> bool:
        """Find the metadata of a message's version; if it is not known, see to it that it is probed for."""
        metadata = writer.stated or self._catalog.find(writer.key, message)
        if metadata is None:
            self._probes.want(writer.key, now)
            return False
        writer.major, writer.minor = message.major_version, message.minor_version
        if message.major_version is not None:
            writer.heard_major = message.major_version
        self._probes.settled(writer.key)
        before = writer.metadata
        if metadata != before:
            if before is None or with_max_age(before.fields, None) != with_max_age(metadata.fields, None):
                writer.last_frame = None
                writer.types = type_codes(metadata.fields)
            writer.metadata = metadata
            said = max_age_s(metadata.fields)
            writer.says_max_age = said is not None
            writer.max_age_s = self._max_ages.get(writer.topic) if said is None else said
            if writer.max_age_s is not None and not writer.silent:
                self._liveness.add(writer)
            events.append(MetaDataReceived(writer.topic, metadata))
        return True

    def _probe(self, keys: list[tuple[PublisherKey, int]], now: float, events: list[SubscriberEvent]) -> None:
        """Probe for what is not known; one probe asks a publisher for many writers."""
        asked: dict[PublisherKey, list[RemoteWriter]] = {}
        for key in keys:
            living = [
                writer
                for writer in self._catalog.writers(key)
                if now - writer.last_heard < self._timeout
                and (writer.metadata is None or writer.doubted or not writer.is_sure(writer.expected))
            ]
            if living:
                asked.setdefault(key[0], []).extend(living)
            else:
                self._probes.settled(key)
        for publisher, writers in asked.items():
            kind, publisher_id = (_UINT16, publisher) if isinstance(publisher, int) else publisher
            for start in range(0, len(writers), IDS_IN_PROBE):
                part = writers[start : start + IDS_IN_PROBE]
                ids = tuple(sorted({writer.key[1] for writer in part}))
                datagram: bytes | None
                datagram = encode_probe(Probe(publisher_id, kind, ProbeKind.DATA_SET_META_DATA.value, ids))
                for writer in part:
                    events.append(SourceUnknown(writer.topic, datagram))
                    datagram = None

    def _count_malformed(self, error: RemoteWireError) -> None:
        self._counters.drop_malformed(error.cause)
        self._complaints.add(error)
