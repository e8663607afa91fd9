"""The DataSetReaders of one process: datagrams in, facts out. What is dropped is counted by its cause.

    datagram -> inlet.py: opened and decoded -> the loop rule, a legal source -> readers.py: what its writer has said

What is refused in one place reaches none of the following. A process may have several connections, each with an inlet;
behind these a writer is one writer, by whichever it is heard. What comes a second time falls by its sequence number or
its Timestamp, and a writer lives while it is heard by any of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from random import Random
from types import MappingProxyType
from typing import Any, Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import TopicInvalid
from ua_fleet.pubsub import components
from ua_fleet.pubsub.announced import Announcements
from ua_fleet.pubsub.catalog import Catalog
from ua_fleet.pubsub.complaints import Complaint, Complaints
from ua_fleet.pubsub.events import (
    ActionReceived,
    DataReceived,
    MetaDataReceived,
    ProbeDue,
    ProbeReceived,
    SetpointReceived,
    SourceAppeared,
    SourceSilent,
    SourceStale,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.inlet import Inlet
from ua_fleet.pubsub.liveness import Liveness
from ua_fleet.pubsub.mapped import MappedSources, PublisherKey, publisher_key
from ua_fleet.pubsub.origins import NO_ORIGINS, Origins
from ua_fleet.pubsub.probing import ProbeSchedule
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.pubsub.readers import DataSetReaders
from ua_fleet.pubsub.refusals import Refusals
from ua_fleet.pubsub.remote_writer import RemoteWriter
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.pubsub.wishes import IDS_IN_PROBE, Wishes
from ua_fleet.topics import SERVER_SPACE, LoopVerdict, Side, Topic, loop_verdict
from ua_fleet.wire import Codec, encode_probe
from ua_fleet.wire.actions import ActionMessage
from ua_fleet.wire.messages import (
    DataSetMessage,
    DataSetMetaData,
    NetworkMessage,
    Probe,
    ProbeKind,
    PublisherIdType,
)
from ua_fleet.wire.security import SecurityMode

__all__ = ["LoopRule", "Subscriber"]

LoopRule = Callable[[Side, int, int, bool], LoopVerdict]
"""`topics.loop_verdict`, or what a test puts in its place."""

_UINT16: Final = PublisherIdType.UINT16.value


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
        barred: Collection[int] = (),
        relayed: Origins = NO_ORIGINS,
        takes_actions: bool = True,
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
            barred: as of `add_connection`, for the first one.
            relayed: the same.
            takes_actions: the same.
            random: where the random delay of probes comes from.
        """
        self.caught: Callable[[str, Exception], None] | None = None
        """Told of a mistake that cost one writer what time has brought it; without it, the mistake is raised."""
        self._own_space = own_space
        self._timeout = timing.receive_timeout_s
        self._counters = counters
        self._rule = rule
        self._codec, self._publisher_ids = codec, publisher_ids
        self._verdicts: dict[int, bool] = {}
        self._max_writers = max_writers
        self._mapped = mapped or MappedSources()
        self._setpoint_groups = setpoint_groups or {}
        self._writers: dict[tuple[int, int | None, int], RemoteWriter] = {}
        self._catalog = Catalog(max_writers)
        random = random or Random()  # noqa: S311 - spreads probes, keeps no secret
        self._probes = ProbeSchedule(random)
        self._wishes = Wishes(random)
        self._liveness = Liveness(self._timeout)
        self._complaints = Complaints()
        self.components = components.Components()
        """What is disabled."""
        self.received_messages = Counter[int]()
        """NetworkMessages with data, by the space that sent them."""
        self.refused_messages = Counter[int]()
        """Messages that say that a space sent them, and that could not be verified or decrypted."""
        self._refusals = Refusals(
            counters, self._complaints, self._writers, known=self._verdicts, messages=self.refused_messages
        )
        self._inlets: list[Inlet] = []
        self.add_connection(envelope, barred=barred, relayed=relayed, takes_actions=takes_actions)
        self._announced = Announcements(
            self._timeout,
            counters,
            max_writers,
            inlets=self._inlets,
            comes_in=self._comes_in,
            mapped=self._mapped,
            writers=self._writers,
            catalog=self._catalog,
            liveness=self._liveness,
            probes=self._probes,
            wishes=self._wishes,
        )
        self._readers = DataSetReaders(
            self._timeout,
            counters,
            catalog=self._catalog,
            liveness=self._liveness,
            probes=self._probes,
            complaints=self._complaints,
            max_ages=max_ages or {},
            returned=self._refusals.forget,
        )

    def add_connection(
        self,
        envelope: Envelope | None,
        *,
        barred: Collection[int] = (),
        relayed: Origins = NO_ORIGINS,
        takes_actions: bool = True,
    ) -> int:
        """Hear by a further connection; its number, for `receive`.

        Args:
            envelope: opens what comes by it.
            barred: spaces that do not come by it, since their bridges are on other connections.
            relayed: what comes by it by relays alone, of these spaces or others.
            takes_actions: whether Actions come by it.
        """
        self._inlets.append(
            Inlet(
                self._own_space,
                self._counters,
                self._codec,
                self._complaints,
                self._comes_in,
                envelope=envelope,
                publisher_ids=self._publisher_ids,
                barred=barred,
                relayed=relayed,
                takes_actions=takes_actions,
            )
        )
        return len(self._inlets) - 1

    @property
    def opened(self) -> Callable[[bytes], None] | None:
        """Told of each plain message before it is decoded; for who looks at messages."""
        return self._inlets[0].opened

    @opened.setter
    def opened(self, told: Callable[[bytes], None] | None) -> None:
        for inlet in self._inlets:
            inlet.opened = told

    @property
    def impostor(self) -> Callable[[tuple[str, int], float], bool] | None:
        """Told who has sent a message with our PublisherId, and when; whether that is somebody else."""
        return self._inlets[0].impostor

    @impostor.setter
    def impostor(self, told: Callable[[tuple[str, int], float], bool] | None) -> None:
        for inlet in self._inlets:
            inlet.impostor = told

    @property
    def is_nearer(self) -> bool:
        """Whether the last datagram may have brought the next deadline nearer.

        A new value of a writer that is heard all the time, and a chunk of a message, do not: chunks that do not come
        are given up after seconds.
        """
        return self._readers.is_nearer

    @property
    def writers(self) -> Mapping[Any, RemoteWriter]:
        """The writers that were heard, by Topic, with their statistics; a live view."""
        return MappingProxyType(self._writers)

    def receive(
        self,
        datagram: bytes,
        now: float,
        sender: tuple[str, int] | None = None,
        *,
        is_fresh: bool = True,
        connection: int = 0,
    ) -> list[SubscriberEvent]:
        """Take one datagram.

        Args:
            datagram: as it came.
            now: the time.
            sender: where it came from: a request may be answered there.
            is_fresh: False for what a broker has kept, which may be of any time: only announcements are taken so.
            connection: the number of the connection that it came by.
        """
        self._readers.is_nearer = True
        inlet = self._inlets[connection]
        try:
            message = inlet.read(datagram, now, sender, is_fresh=is_fresh)
        except DatagramRefused as refused:
            return self._refusals.add(refused)
        if message is None:
            self._readers.is_nearer = not inlet.is_incomplete
            return []
        if type(message) is NetworkMessage:
            if len(self._inlets) > 1:
                inlet.hear(message.publisher_id, now, self._max_writers)
            return self._receive_data(message, inlet, now)
        if isinstance(message, Probe):
            return self._receive_probe(message, now)
        if isinstance(message, ActionMessage):
            return self._receive_action(message, sender, inlet)
        if isinstance(message, NetworkMessage):
            return []
        # A relay says as fresh what a broker may have kept for it.
        is_fresh = is_fresh and not inlet.relays(message.publisher_id, message.publisher_id_type)
        return self._announced.take(message, inlet, now, is_fresh=is_fresh)

    def known(self, topic: Topic) -> list[SubscriberEvent]:
        """What was heard of a source last, for one who begins to follow it now."""
        writer = self._writers.get(topic)
        if writer is None or writer.metadata is None:
            return []
        events: list[SubscriberEvent] = [MetaDataReceived(topic, writer.metadata)]
        if writer.last_frame is not None:
            events.append(DataReceived(topic, writer.last_frame, writer.metadata))
        elif writer.has_appeared and not (writer.silent or writer.stale or writer.is_gone):
            events.append(SourceAppeared(topic))
        if writer.silent or writer.stale:
            events.append(SourceSilent(topic) if writer.silent else SourceStale(topic))
        return events

    def hears(self, topic: Topic) -> bool:
        """Whether a source is heard now, and what its messages mean is known."""
        writer = self._writers.get(topic)
        return writer is not None and writer.metadata is not None and not writer.silent

    def disable(self, component: components.Component) -> list[SubscriberEvent]:
        """Take nothing for a component and what is below it: what it reads is silent at once; raises StateInvalid."""
        self.components.disable(component)
        events: list[SubscriberEvent] = []
        for writer in self._writers.values():
            if components.reader(writer.topic)[: len(component)] == component:
                self._liveness.end(writer, events)
                writer.doubted = True  # nobody looks at what comes meanwhile
        return events

    def enable(self, component: components.Component) -> None:
        """Take again what comes from now on; raises StateInvalid."""
        self.components.enable(component)

    def _is_off(self, component: components.Component) -> bool:
        """Whether nothing is taken for a component."""
        return not self.components.is_whole and not self.components.is_operational(component)

    def want_action(self, publisher_id: int, data_set_writer_id: int, now: float) -> bool:
        """Ask for the Actions of a DataSetWriter until they are announced; False if there are too many wishes.

        What is announced comes as AnnouncementReceived, the probes as ProbeDue.
        """
        return self._wishes.want_action(publisher_id, data_set_writer_id, now)

    def unwant_action(self, publisher_id: int, data_set_writer_id: int) -> None:
        """Ask no longer for the Actions of a DataSetWriter."""
        self._wishes.unwant_action(publisher_id, data_set_writer_id)

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
            except Exception as error:  # counted; the other steps have nothing to do with it
                if self.caught is None:
                    raise
                self.caught("silences", error)
        return events

    def _poll_envelope(self, now: float, _events: list[SubscriberEvent]) -> None:
        for inlet in self._inlets:
            if inlet.envelope is not None:
                inlet.envelope.poll(now)

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
        for inlet in self._inlets:
            chunks = None if inlet.envelope is None else inlet.envelope.next_deadline()
            if chunks is not None:
                due = chunks if due is None else min(due, chunks)
        return due

    def complaints(self, now: float) -> list[Complaint]:
        """What is to be logged of malformed and refused datagrams: each cause at once, then at most once a minute."""
        return self._complaints.take(now)

    def _receive_data(self, message: NetworkMessage, inlet: Inlet, now: float) -> list[SubscriberEvent]:
        parts = message.messages
        self._counters.messages_in += len(parts)
        publisher_id = message.publisher_id
        events: list[SubscriberEvent] = []
        if not self.components.is_whole and self._is_off(components.CONNECTION):
            self._counters.drop(Drop.DISABLED, len(parts))
            return events
        if self._mapped:
            parts = self._receive_mapped(message, inlet, now, events)
            if not parts:
                self._readers.is_nearer = True
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
            return self._receive_setpoints(group_id, parts, inlet)
        self.received_messages[publisher_id] += 1
        for part in parts:
            topic = publisher_id, group_id, part.data_set_writer_id
            if not self.components.is_whole and self._is_off(("R", publisher_id, group_id or 0, topic[2])):
                self._counters.drop(Drop.DISABLED)
                continue
            writer = self._writers.get(topic)
            if writer is None and part.valid:
                writer = self._meet(publisher_id, group_id, part.data_set_writer_id, now)
                if writer is None:
                    self._counters.drop(Drop.UNKNOWN_SOURCE)
                    self._complaints.add_unknown(message)
                    continue
            self._readers.take(writer, part, message.timestamp, now, events)
        if len(message.messages) != 1:  # the last one does not speak for the others
            self._readers.is_nearer = True
        return events

    def _receive_setpoints(
        self, group_id: int, parts: tuple[DataSetMessage, ...], inlet: Inlet
    ) -> list[SubscriberEvent]:
        """Hand on setpoints for us; on multicast everybody hears those for others."""
        if self._setpoint_groups[group_id] != self._own_space:
            return []
        if not inlet.takes_actions or inlet.relays(SERVER_SPACE):
            self._counters.drop(Drop.NOT_ITS_CONNECTION, len(parts))
            return []
        return [SetpointReceived(group_id, part) for part in parts]

    def _receive_mapped(
        self, message: NetworkMessage, inlet: Inlet, now: float, events: list[SubscriberEvent]
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
            elif inlet.bars(source.topic.space) and not inlet.relays(publisher_id, message.publisher_id_type):
                # as the other data of its robot, unless a relay may speak for the publisher itself
                self._counters.drop(Drop.NOT_ITS_CONNECTION)
            elif self._is_off(components.reader(source.topic)):
                self._counters.drop(Drop.DISABLED)
            else:
                self.received_messages[source.topic.space] += part is message.messages[0]
                writer = self._writers.get(source.topic)
                if writer is None and part.valid:
                    writer = self._know(source.topic, now, (publisher, part.data_set_writer_id), source.metadata)
                    if writer is None:
                        self._counters.drop(Drop.UNKNOWN_SOURCE)
                        continue
                self._readers.take(writer, part, message.timestamp, now, events)
        return tuple(rest)

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

    def _receive_action(
        self, message: ActionMessage, sender: tuple[str, int] | None, inlet: Inlet
    ) -> list[SubscriberEvent]:
        """Hand on requests to us, and responses to anybody but us: multicast brings those of others too."""
        is_ours = message.publisher_id_type == _UINT16 and message.publisher_id == self._own_space
        if message.is_request is not is_ours:
            return []
        self._counters.messages_in += 1 + len(message.others)
        if not inlet.takes_actions:
            self._counters.drop(Drop.NOT_ITS_CONNECTION, 1 + len(message.others))
            return []
        return [ActionReceived(message, sender, inlet.mode is not SecurityMode.NONE)]

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
        self._refusals.forget(topic)
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
