"""What a DataSetMessage of a known writer passes before its values count.

The gates stand in this order: the valid flag, the sequence of its writer, the Timestamp, metadata of its version, and
the types of its fields. Only what passes all of them, or repeats what did, says that a value is of now.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import RemoteWireError
from ua_fleet.pubsub.catalog import Catalog
from ua_fleet.pubsub.complaints import Complaints
from ua_fleet.pubsub.events import DataReceived, EventReceived, MetaDataReceived, SubscriberEvent
from ua_fleet.pubsub.frames import merge_delta, types_fit
from ua_fleet.pubsub.liveness import Liveness
from ua_fleet.pubsub.metadata import max_age_s, type_codes, with_max_age
from ua_fleet.pubsub.probing import ProbeSchedule
from ua_fleet.pubsub.remote_writer import RemoteWriter, SequenceStep
from ua_fleet.pubsub.sequence import MASK
from ua_fleet.topics import Topic
from ua_fleet.wire import decode_raw_fields
from ua_fleet.wire.messages import DataSetMessage, FieldEncoding, FrameKind

__all__ = ["DataSetReaders"]

_KEY: Final = FrameKind.KEY.value
_DELTA: Final = FrameKind.DELTA.value
_EVENT: Final = FrameKind.EVENT.value
_KEEP_ALIVE: Final = FrameKind.KEEP_ALIVE.value
_VARIANT: Final = FieldEncoding.VARIANT.value
_RAW: Final = FieldEncoding.RAW_DATA.value


class DataSetReaders:
    """The gates of all writers of one process; which writers there are, its owner decides."""

    def __init__(
        self,
        timeout_s: float,
        counters: Counters,
        *,
        catalog: Catalog,
        liveness: Liveness,
        probes: ProbeSchedule,
        complaints: Complaints,
        max_ages: Mapping[Topic, float],
        returned: Callable[[Topic], None],
    ) -> None:
        """Connect them.

        Args:
            timeout_s: MessageReceiveTimeout.
            counters: what is dropped is counted here.
            catalog: the metadata that was announced.
            liveness: learns what attests a writer.
            probes: learns what is missing.
            complaints: learns of what is malformed.
            max_ages: maximum ages in seconds of the values of writers that announce none themselves.
            returned: told of a silent source that is about to be attested.
        """
        self.is_nearer = True
        """Whether the last message may have brought the next deadline nearer."""
        self._timeout, self._counters, self._max_ages, self._returned = timeout_s, counters, max_ages, returned
        self._catalog, self._liveness, self._probes, self._complaints = catalog, liveness, probes, complaints

    def take(
        self,
        writer: RemoteWriter | None,
        part: DataSetMessage,
        timestamp: int | None,
        now: float,
        events: list[SubscriberEvent],
    ) -> None:
        """Take a message of a writer, None where its writer is not known and it is not valid.

        `timestamp` is that of the NetworkMessage.
        """
        if writer is None or not part.valid:
            self._counters.drop(Drop.INVALID)
            if writer is not None:
                writer.doubted = True
                writer.failed += 1
        elif part.kind == _KEEP_ALIVE:
            self._take_keep_alive(writer, part, now, events)
        else:
            if part.timestamp is None and timestamp:
                part = part._replace(timestamp=timestamp)
            self._take_frame(writer, part, now, events)

    def _take_frame(
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
            writer.failed += 1
            self._counters.drop(Drop.NO_METADATA)
            return
        writer.received += 1
        if frame.kind == _EVENT:
            self._take_event(writer, frame, is_new or number is not None, now, events)
            return
        if not is_new:
            self._counters.drop(Drop.REPEATED)
            if writer.repeats(frame):
                self._attest(writer, now, events)
            elif number is None:  # a keep-alive after it has no number either that would tell of it
                writer.doubted = True
            elif not (writer.silent or writer.is_gone) and writer.may_be_set_back(frame, now):
                self._liveness.live(writer, now, events)  # it will soon be taken
            return
        if frame.kind != _KEY or frame.encoding != _VARIANT or frame.types != writer.types:
            if frame.kind == _KEY and frame.encoding != _RAW and not frame.types and writer.types:
                self._take_heartbeat(writer, number, now, events)
                return
            checked = self._check(writer, frame, now)
            if checked is None:
                writer.doubted = True
                writer.failed += 1
                return
            frame = checked
        is_first = not writer.has_said
        writer.hand_on(frame)
        writer.alive_at = writer.attested_at = writer.said_at = now
        if writer.silent or writer.stale:
            self._attest(writer, now, events, is_followed=True)
        elif is_first and writer.max_age_s is not None:
            self._liveness.add(writer)
        else:
            self.is_nearer = bool(events)  # its metadata, with a maximum age
        assert writer.metadata is not None
        events.append(DataReceived(writer.topic, frame, writer.metadata))

    def _take_event(
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
            writer.failed += 1
            self._counters.drop(Drop.LAYOUT)
            self._probes.want(writer.key, now)
            return
        if event.timestamp is not None:
            writer.handed_on = max(writer.handed_on, event.timestamp)
        self._attest(writer, now, events)
        events.append(EventReceived(writer.topic, event, metadata))

    def _take_heartbeat(
        self, writer: RemoteWriter, number: int | None, now: float, events: list[SubscriberEvent]
    ) -> None:
        """Take a key frame without fields (OPC 10000-14 5.3.3): it says what a keep-alive says."""
        if writer.is_sure(number):
            writer.confirm(number)
            self._alive(writer, now, events)
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
                self._counters.drop_malformed(error.cause)
                self._complaints.add(error)
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

    def _take_keep_alive(
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
                self._alive(writer, now, events)
            return
        if writer.is_sure(message.sequence_number) and not writer.is_of_another_version(message):
            self._alive(writer, now, events)
            return
        self._liveness.live(writer, now, events)
        if writer.gaps != gaps:
            self._probes.want(writer.key, now)  # who is asked says its last message again

    def _attest(
        self, writer: RemoteWriter, now: float, events: list[SubscriberEvent], *, is_followed: bool = False
    ) -> None:
        if writer.silent:
            self._returned(writer.topic)
        self._liveness.attest(writer, now, events, is_followed=is_followed)

    def _alive(self, writer: RemoteWriter, now: float, events: list[SubscriberEvent]) -> None:
        if writer.silent:
            self._returned(writer.topic)
        self._liveness.alive(writer, now, events)

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
