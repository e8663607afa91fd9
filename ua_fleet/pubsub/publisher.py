"""The DataSetWriters of one process.

Each mirrored message is a key frame. A writer repeats its last one, so that who comes late or lost it still gets the
value; the Timestamp of a repeat is unchanged, and otherwise Timestamps strictly increase: that is how a receiver tells
the two apart. A keep-alive attests the source, not this process. Where the clock was ahead, they go back once.

    (new)  --announce-->           alive: repeats and keep-alives
    alive  --source_lost-->        lost: one frame with Bad_NoCommunication, then silence
    lost   --announce, publish-->  alive
    any    --retire-->             forgotten but for its numbers, which go on when it is announced again
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Mapping
from itertools import count
from types import MappingProxyType
from typing import Any, Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import LocalWireError, MessageTooLarge
from ua_fleet.pubsub.announcer import ANSWER_INTERVAL_S, Announcer
from ua_fleet.pubsub.application import MAX_DATAGRAM_BYTES, PRODUCT_URI, Application, describe
from ua_fleet.pubsub.components import Components
from ua_fleet.pubsub.layout import PLAIN, WriterSettings
from ua_fleet.pubsub.metadata import fields_version, with_max_age
from ua_fleet.pubsub.pacing import Pace
from ua_fleet.pubsub.packing import HEADER_BYTES, MAX_PACKED_BYTES, pack
from ua_fleet.pubsub.sequence import MASK
from ua_fleet.pubsub.switching import WriterSwitches
from ua_fleet.pubsub.timestamps import Timestamps
from ua_fleet.pubsub.timing import PubSubTiming, version_time
from ua_fleet.pubsub.writer import Writer
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire import Codec, encode_metadata_announcement
from ua_fleet.wire.discovered import (
    ActionMetaDataAnnouncement,
    ActionMethod,
    ActionTarget,
    PubSubConnection,
    WriterGroup,
)
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldMetaData,
    MetaDataAnnouncement,
    NetworkMessage,
    Probe,
    ProbeKind,
    PublisherIdType,
)

__all__ = ["MAX_DATAGRAM_BYTES", "Publisher"]

_EARLY: Final = 0.05
"""Part of its period that any other message may go early, to share a NetworkMessage with one that is due."""
TOGETHER: Final = 0.5
"""Part of its period that a keep-alive may go early, to go with others."""
_MOST_AT_ONCE: Final = 256
"""Writers that one call serves, about a millisecond of work; `next_deadline` then asks for the next call at once."""
_REPEATED_BYTES_PER_SECOND: Final = 50_000
"""What the repeats of one writer may take."""
_UINT16: Final = PublisherIdType.UINT16.value

_Batches = dict[int, list[tuple[DataSetMessage, int]]]
"""DataSetMessages with their sizes, by WriterGroup."""


class Publisher:
    """All DataSetWriters of one process. Every method that sends returns the datagrams to send, in order."""

    def __init__(
        self,
        publisher_id: int,
        timing: PubSubTiming,
        counters: Counters,
        codec: Codec,
        application: Application | None = None,
        *,
        max_packed_bytes: int = MAX_PACKED_BYTES,
        settings: Mapping[Topic, WriterSettings] | None = None,
        timestamps: Timestamps | None = None,
    ) -> None:
        """Make a publisher without writers.

        Args:
            publisher_id: the space whose data this process originates.
            timing: periods of keep-alives, repeats and announcements.
            counters: `messages_out` is counted here.
            codec: the process's codec.
            application: what the process says of itself when it is asked; the size of its messages stands there too.
            max_packed_bytes: several DataSetMessages share a NetworkMessage up to this size; it must fit into a
                datagram, since only a NetworkMessage of one DataSetMessage can be sent as chunks.
            settings: how writers send that do not send key frames of Variants.
            timestamps: where Timestamps do not increase by themselves, says which one is sent.
        """
        self._id = publisher_id
        self._timing = timing
        self._early_s = _EARLY * min(timing.keep_alive_s, timing.repeat_interval_s, timing.announce_interval_s)
        self._counters = counters
        self._codec = codec
        self._max_packed_bytes = min(max_packed_bytes, MAX_PACKED_BYTES)
        if application is not None and application.is_brokered:
            self._max_packed_bytes = 0  # each DataSetWriter has a topic of its own (6.4.2.5.1)
        self._writers: dict[tuple[int, int, int], Writer] = {}
        self._by_id: dict[int, list[Writer]] = {}
        """The writers of each DataSetWriterId: one, unless several WriterGroups use it."""
        self._majors: dict[int, int] = {}
        """The highest major version of each DataSetWriterId: announcements name no WriterGroup."""
        self._deadlines: list[tuple[float, int, Writer]] = []
        self._answers: list[tuple[float, int, Writer]] = []
        self._order = count(1)
        self._announcement_number = 0
        self._pace = Pace()
        self.timestamps = timestamps or Timestamps()
        if application is None:
            application = Application(describe(f"{PRODUCT_URI}:{publisher_id}", f"publisher {publisher_id}"))
        self.sent_messages = Counter[int]()
        """NetworkMessages by WriterGroupId."""
        self._settings = settings or {}
        components = Components()
        self._announcer = Announcer(
            publisher_id,
            timing,
            application,
            self._next_announcement_number,
            self._pace,
            self._settings,
            components,
        )
        self.switches = WriterSwitches(components, self._writers, self._announcer, self.source_lost, self._queue)
        """Disables DataSetWriters, and enables them."""

    @property
    def writers(self) -> Mapping[Any, Writer]:
        """The writers by Topic, retired ones too; a live view."""
        return MappingProxyType(self._writers)

    def configuration(self, number: int = 0) -> PubSubConnection:
        """How one of its PubSubConnections is configured, down to the WriterGroups."""
        return self._announcer.configuration(number)

    def group(self, ns: int, number: int = 0) -> WriterGroup:
        """How a WriterGroup of a PubSubConnection is configured, with its DataSetWriters."""
        return self._announcer.group(ns, number)

    def describe(self, application: Application) -> None:
        """Say this of the process from now on."""
        self._announcer.describe(application)

    def begin(self, *, now: float, wall_ticks: int) -> list[bytes]:
        """Announce the application, and that it is Operational; `poll` does so again with a period."""
        self.timestamps.set_clock(now, wall_ticks)
        return self._announcer.begin(now, wall_ticks)

    def end(self) -> list[bytes]:
        """Say in order that this publisher ends (7.2.4.6.7)."""
        return self._announcer.end()

    def announce(
        self, topic: Topic, name: str, fields: tuple[FieldMetaData, ...], *, now: float, wall_ticks: int
    ) -> list[bytes]:
        """Make or update the writer of a source that is alive.

        Returns its metadata announcement, and a keep-alive, which tells readers the WriterGroup. Other fields than
        before get a new major version, another name or maximum age alone a new minor version (OPC 10000-14 6.2.3.2.6).

        Raises:
            LocalWireError: a source of another space, or metadata that cannot be encoded.
        """
        if topic.space != self._id:
            raise LocalWireError(f"{topic.name} does not originate in space {self._id}")
        self.timestamps.set_clock(now, wall_ticks)
        known = self._writers.get(topic)
        writer = known or self._new_writer(topic)
        metadata = self._versioned(writer, name, fields, wall_ticks)
        announcement = self._announcement(writer.topic.id, metadata)
        if known is None:
            self._writers[topic] = writer
            self._by_id.setdefault(topic.id, []).append(writer)
        if writer.encode is None or metadata is not writer.metadata:
            writer.lay_out(metadata, self._codec)
        self._announcer.put_writer(topic.ns, topic.id, name, now)
        if writer.is_off:
            writer.was_alive = True
            return []
        writer.announce_at = now + self._timing.announce_interval_s
        writer.sent_at = now
        self._revive(writer, now)
        return [announcement, *self._send({topic.ns: [writer.keep_alive()]})]

    def publish(
        self,
        topic: Topic,
        values: tuple[Any, ...],
        *,
        timestamp: int,
        status: int = 0,
        now: float,
        types: tuple[int, ...] | None = None,
    ) -> list[bytes]:
        """Send a message at once: a key frame, unless the writer is set otherwise.

        Args:
            topic: an announced source.
            values: one for each field, in their order.
            timestamp: the source's time in ticks; where it does not move forward, the last one plus one tick is sent,
                unless the last one is far in the future.
            status: of the whole message; its upper 16 bits travel.
            now: the time.
            types: where a field has another type code than its metadata says, e.g. a StatusCode in place of a value.

        Raises:
            LocalWireError: not announced, or values that do not fit. Nothing has changed then.
        """
        writer = self._writers.get(topic)
        if writer is None or (encode := writer.encode) is None:
            raise LocalWireError(f"{topic.name} is published before it is announced")
        maker = writer.maker
        if types is None:
            types = writer.types
        elif types != writer.types:
            if len(types) != len(writer.types):
                raise LocalWireError(f"{topic.name}: {len(types)} types for {len(writer.types)} fields")
            if maker is None:
                encode = writer.encoder(types, self._codec)
        if timestamp <= writer.timestamp:
            timestamp = self.timestamps.after(topic, writer.timestamp, timestamp, now)
        number = writer.next_number
        frame = None if maker is None else maker.make(number, timestamp, status, types, values)
        datagram = encode(number, timestamp, status, values) if frame is None else frame.datagram
        size = len(datagram)
        if size > (most := self._announcer.application.max_message_bytes):
            raise MessageTooLarge(f"{topic.name}: {size} bytes, and the largest message may have {most}")
        if writer.is_off:  # only now: what does not fit is refused before it is kept
            self._counters.drop(Drop.DISABLED)
            writer.keep(types, values, status, timestamp, size - HEADER_BYTES if frame is None else frame.size)
            return []
        writer.next_number = (number + 1) & MASK
        writer.timestamp = timestamp
        writer.sent_at = now
        is_first = False
        if maker is not None and frame is not None:
            maker.taken(frame)
        if not writer.settings.are_events:
            is_first = writer.values is None
            writer.values = values
            writer.sent_types = types
            writer.status = status
            writer.size = size - HEADER_BYTES if frame is None else frame.size
            if frame is None or frame.is_key:  # a delta frame says nothing to one who comes late
                writer.repeat_at = now + self._repeat_after_s(writer)
        if is_first or not writer.alive:
            self._revive(writer, now)
        self._counters.messages_out += 1
        self.sent_messages[topic.ns] += 1
        return [datagram]

    def count_failed(self, topic: Topic) -> None:
        """A message of a source could not be made."""
        if (writer := self._writers.get(topic)) is not None:
            writer.failed += 1

    def restate(self, topic: Topic, *, status: int, timestamp: int = 0, now: float) -> list[bytes]:
        """Say the last values of a source that is alive with another status, as of `timestamp` if that is later.

        Nothing where there are none.
        """
        writer = self._writers.get(topic)
        if writer is None or writer.values is None or not (writer.alive or writer.was_alive):
            return []
        return self.publish(topic, writer.values, timestamp=timestamp, status=status, now=now, types=writer.sent_types)

    def source_lost(self, topic: Topic, *, timestamp: int, now: float) -> list[bytes]:
        """Say once that the source is gone, with its last values; then be silent until `announce` or `publish`."""
        writer = self._writers.get(topic)
        if writer is not None:
            writer.was_alive = False
        if writer is None or not writer.alive:
            return []
        if writer.settings.are_events:  # there is no last value that could be of now
            writer.alive = False
            return []
        status = int(StatusCode.BAD_NO_COMMUNICATION)
        values, types = writer.values, writer.sent_types
        if values is None:
            values = (status,) * len(writer.types)
            types = (int(BuiltinType.STATUS_CODE),) * len(writer.types)
        timestamp = max(timestamp, writer.timestamp + 1)  # it is said once, and is news at once
        datagrams = self.publish(topic, values, timestamp=timestamp, status=status, now=now, types=types)
        writer.alive = False
        return datagrams

    def _new_writer(self, topic: Topic) -> Writer:
        writer = Writer(topic, self._settings.get(topic, PLAIN))
        writer.is_off = self.switches.is_off(topic)
        return writer

    def retire(self, topic: Topic) -> None:
        """Forget a source. Its numbers are kept, so that they go on if it is announced again."""
        writer = self._writers.get(topic)
        if writer is not None:
            writer.retire()
            self._announcer.remove_writer(topic.ns, topic.id)

    def announce_action(
        self,
        topic: Topic,
        name: str,
        targets: tuple[ActionTarget, ...],
        request: tuple[FieldMetaData, ...],
        response: tuple[FieldMetaData, ...],
        *,
        methods: tuple[ActionMethod, ...] = (),
        now: float,
        wall_ticks: int,
    ) -> list[bytes]:
        """Announce an Action that this process responds to, or that one of it has changed.

        Args:
            topic: (space, WriterGroupId, DataSetWriterId) of its messages; no DataSet has this id.
            name: of the Action.
            targets: whom it can be asked of.
            request: the fields of an ActionRequest.
            response: the fields of an ActionResponse.
            methods: none, or for each target the Method that does the same in the OPC UA server.
            now: the time.
            wall_ticks: the wall clock, from which a minor version is made. The major one says which names and types the
                fields have; another name, other targets or other fields than before get a new minor one.

        Raises:
            LocalWireError: an Action of another space, an id that a DataSet has, or what cannot be encoded.
        """
        if topic.space != self._id:
            raise LocalWireError(f"the Action {topic.name} is not of space {self._id}")
        if any(writer.encode for writer in self._by_id.get(topic.id, ())):
            raise LocalWireError(f"{topic.name} is a DataSet, and cannot be an Action as well")
        before = self._announcer.action(topic.id)
        version = ConfigurationVersion(0, 0) if before is None else before.request.configuration_version
        said = (name, request, targets, response, methods)
        if before is None or said != (
            before.request.name,
            before.request.fields,
            before.targets,
            before.response.fields,
            before.methods,
        ):
            minor = max(version.minor + 1, version_time(wall_ticks))
            version = ConfigurationVersion(fields_version(request, response), minor)
        metadata = DataSetMetaData(name, request, version)
        action = ActionMetaDataAnnouncement(
            self._id, _UINT16, 0, topic.id, targets, metadata, metadata._replace(fields=response), methods
        )
        return self._announcer.put_action(topic.ns, action, now)

    def retire_action(self, topic: Topic, *, now: float, wall_ticks: int) -> list[bytes]:
        """Say that an Action can be asked of nobody any more: it is announced without targets."""
        action = self._announcer.action(topic.id)
        if action is None or not action.targets:
            return []
        request, response = action.request, action.response
        return self.announce_action(
            topic, request.name, (), request.fields, response.fields, now=now, wall_ticks=wall_ticks
        )

    def answer(self, probe: Probe, now: float) -> list[bytes]:
        """Answer a probe: with announcements, and for metadata a repeat of each writer's last message.

        An answer that would follow the one before too soon, and what is more than receivers can take at once, waits
        for `poll`. A probe for what waits already is discarded.
        """
        if probe.kind != ProbeKind.FIND_APPLICATIONS and (
            probe.publisher_id_type != _UINT16 or probe.publisher_id != self._id
        ):
            return []
        self._announcer.ask(probe, now)
        datagrams = self._answer_metadata(probe, now) if probe.kind == ProbeKind.DATA_SET_META_DATA else []
        return datagrams + self._announcer.poll(now)

    def said_last(self) -> list[bytes]:
        """What was said last, for one in this process that begins to listen: Actions, metadata, data.

        Nothing of it is to be sent: it uses no sequence numbers, and takes no turn from those that have asked.
        """
        number, announcements, batches = self._announcement_number, self._announcer.actions(), _Batches()
        for writer in self._writers.values():
            if writer.encode is None or writer.is_off:
                continue
            announcement = MetaDataAnnouncement(self._id, _UINT16, number, writer.topic.id, writer.metadata)
            announcements.append(encode_metadata_announcement(announcement))
            if writer.values is not None or writer.alive:
                batches.setdefault(writer.topic.ns, []).append(writer.said_last())
        return announcements + [
            self._encoded(ns, messages)
            for ns, batch in batches.items()
            for messages in pack(batch, self._max_packed_bytes)
        ]

    def _answer_metadata(self, probe: Probe, now: float) -> list[bytes]:
        announced = [(asked, self._by_id.get(asked, ())) for asked in probe.data_set_writer_ids or tuple(self._by_id)]
        if probe.data_set_writer_ids:
            self._announcer.deny([asked for asked, writers in announced if not any(w.encode for w in writers)], now)
        for writer in [writer for _, writers in announced for writer in writers]:
            if writer.encode is None or writer.answer_pending or writer.is_off:
                continue
            writer.answer_pending = True
            due = max(now, writer.answered_at + ANSWER_INTERVAL_S)
            heapq.heappush(self._answers, (due, next(self._order), writer))
        return self._send_due_answers(now)

    def poll(self, now: float, wall_ticks: int | None = None, *, is_round: bool = False) -> list[bytes]:
        """Send what is due: answers that waited, announcements, repeats and keep-alives.

        With one keep-alive go all those that have half of their period behind them, so that a process with many quiet
        writers wakes once in a period for all of them, and so do those who listen.

        Args:
            now: the time.
            wall_ticks: the wall clock, where it is known: a status tells it, and Timestamps are measured by it.
            is_round: whether the process wakes with a period anyhow, so that keep-alives may go with that.
        """
        if wall_ticks is not None:
            self.timestamps.set_clock(now, wall_ticks)
            self._announcer.set_clock(now, wall_ticks)
        datagrams = self._send_due_answers(now) + self._announcer.poll(now)
        deadlines, pace = self._deadlines, self._pace
        if not deadlines or (deadlines[0][0] > now and not is_round):
            return datagrams
        keep_alive_s = self._timing.keep_alive_s
        horizon = now + self._early_s
        latest = now + TOGETHER * keep_alive_s if is_round else horizon
        batches: _Batches = {}
        served: list[Writer] = []
        while len(served) < _MOST_AT_ONCE and deadlines and deadlines[0][0] <= latest and pace.allows(now):
            _, entry, writer = heapq.heappop(deadlines)
            if entry != writer.entry or not writer.alive:
                continue
            served.append(writer)
            if writer.announce_at <= horizon:
                datagrams.append(self._announce_again(writer, now))
            if writer.values is not None and writer.repeat_at <= horizon:
                self._add_repeat(batches, writer, now)
            elif self._is_keep_alive_due(writer, now, horizon, is_round):
                self._add_keep_alive(batches, writer, now)
                latest, is_round = now + TOGETHER * keep_alive_s, True
        for writer in served:
            self._queue(writer)
        return datagrams + self._send(batches)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None. It may find nothing to send then."""
        due = self._announcer.next_deadline()
        for heap in (self._deadlines, self._answers):
            if heap and (due is None or heap[0][0] < due):
                due = heap[0][0]
        if due is None:
            return None
        ready = self._pace.ready_at
        return due if due > ready else ready

    def names_of(self, writer_id: int) -> tuple[str, str] | None:
        """The names of the WriterGroup and of the DataSetWriter with an id, also of an Action's; None without one."""
        return self._announcer.names_of(writer_id)

    def metadata(self, topic: Topic) -> DataSetMetaData | None:
        """The metadata that is announced for a source, or None."""
        writer = self._writers.get(topic)
        return None if writer is None or writer.encode is None else writer.metadata

    def _versioned(
        self, writer: Writer, name: str, fields: tuple[FieldMetaData, ...], wall_ticks: int
    ) -> DataSetMetaData:
        before = writer.metadata
        version = before.configuration_version
        if version.major and with_max_age(before.fields, None) == with_max_age(fields, None):
            if before.name == name and before.fields == fields:
                return before
            minor = max(version.minor + 1, version_time(wall_ticks))
            return DataSetMetaData(name, fields, ConfigurationVersion(version.major, minor))
        major = max(self._majors.get(writer.topic.id, 0) + 1, version_time(wall_ticks))
        self._majors[writer.topic.id] = major
        return DataSetMetaData(name, fields, ConfigurationVersion(major, major))

    def _next_announcement_number(self) -> int:
        number = self._announcement_number
        self._announcement_number = (number + 1) & MASK
        return number

    def _announcement(self, id: int, metadata: DataSetMetaData) -> bytes:
        number = self._announcement_number
        announcement = encode_metadata_announcement(MetaDataAnnouncement(self._id, _UINT16, number, id, metadata))
        size, most = len(announcement), self._announcer.application.max_message_bytes
        if size > most:
            raise LocalWireError(f"metadata of {metadata.name}: {size} bytes, and the largest message may have {most}")
        self._announcement_number = (number + 1) & MASK
        return announcement

    def _announce_again(self, writer: Writer, now: float) -> bytes:
        announcement = self._announcement(writer.topic.id, writer.metadata)
        writer.announce_at = now + self._timing.announce_interval_s
        self._pace.take(len(announcement), datagrams=1)
        return announcement

    def _revive(self, writer: Writer, now: float) -> None:
        if not writer.alive:
            writer.alive = True
            writer.repeat_at = now + self._timing.repeat_interval_s
            writer.announce_at = now + self._timing.announce_interval_s
        self._queue(writer)

    def _queue(self, writer: Writer) -> None:
        """Enter the writer for its next deadline. Publishing moves the deadline back without touching the heap."""
        writer.entry = next(self._order)
        heapq.heappush(self._deadlines, (writer.deadline(self._timing.keep_alive_s), writer.entry, writer))

    def _send_due_answers(self, now: float) -> list[bytes]:
        answers = self._answers
        if not answers or answers[0][0] > now:
            return []
        datagrams: list[bytes] = []
        batches: _Batches = {}
        for _ in range(_MOST_AT_ONCE):
            if not answers or answers[0][0] > now or not self._pace.allows(now):
                break
            _, _, writer = heapq.heappop(answers)
            writer.answer_pending = False
            if writer.encode is None or writer.is_off:
                continue
            writer.answered_at = now
            datagrams.append(self._announce_again(writer, now))
            if writer.values is not None:
                self._add_repeat(batches, writer, now)
            elif writer.alive:
                self._add_keep_alive(batches, writer, now)
        return datagrams + self._send(batches)

    def _add_repeat(self, batches: _Batches, writer: Writer, now: float) -> None:
        message = writer.repeat()
        writer.sent_at = now
        writer.repeat_at = now + self._repeat_after_s(writer)
        batches.setdefault(writer.topic.ns, []).append(message)
        self._pace.take(message[1])

    def _is_keep_alive_due(self, writer: Writer, now: float, horizon: float, is_round: bool) -> bool:
        period_s = writer.keep_alive_period_s(self._timing.keep_alive_s)
        due = writer.sent_at + period_s
        return due <= horizon or (is_round and due <= now + TOGETHER * period_s)

    def _repeat_after_s(self, writer: Writer) -> float:
        """Images are repeated less often, so that a robot that rests costs little; who asks gets them at once."""
        return max(self._timing.repeat_interval_s, writer.size / _REPEATED_BYTES_PER_SECOND)

    def _add_keep_alive(self, batches: _Batches, writer: Writer, now: float) -> None:
        message = writer.keep_alive()
        writer.sent_at = now
        batches.setdefault(writer.topic.ns, []).append(message)
        self._pace.take(message[1])

    def _send(self, batches: _Batches) -> list[bytes]:
        """The NetworkMessages with these DataSetMessages."""
        datagrams: list[bytes] = []
        for ns, batch in batches.items():
            for messages in pack(batch, self._max_packed_bytes):
                self._counters.messages_out += len(messages)
                self.sent_messages[ns] += 1
                self._pace.take(0, datagrams=1)
                datagrams.append(self._encoded(ns, messages))
        return datagrams

    def _encoded(self, ns: int, messages: tuple[DataSetMessage, ...]) -> bytes:
        return self._codec.encode(NetworkMessage(self._id, _UINT16, writer_group_id=ns, messages=messages))
