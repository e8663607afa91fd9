"""A DataSetWriter as a reader knows it: its sequence, its Timestamps, and whether it lives.

Sequences are tracked for each DataSetWriter, never for the group. Of a message with a sequence number:

    the next one             taken
    a newer one              taken; what is missing between is counted
    counted as missing       late: taken if it is an event, or its Timestamp is the latest (a keep-alive was faster)
    not newer, but a proof   taken as a restart; proofs are a later major version, a later Timestamp than all before,
    of a restart             or a silence longer than MessageReceiveTimeout
    not newer                dropped as a duplicate

Of what is taken, only a message with a later Timestamp than the last one handed on is handed on.

A writer is *sure* while the value that was handed on last is what it has, as far as was heard: nothing came after it
that was missed or dropped, and it was not started anew since.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from ua_fleet.counters import Counters
from ua_fleet.pubsub.mapped import PublisherKey
from ua_fleet.pubsub.sequence import MASK, NEWEST_STEP, MissingNumbers
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData, FrameKind

__all__ = ["NO_COMMUNICATION", "UNBOUND", "RemoteWriter", "SequenceStep"]

UNBOUND: Final = -1
"""In place of a major version: the metadata has to be looked up."""
NO_COMMUNICATION: Final = int(StatusCode.BAD_NO_COMMUNICATION) >> 16
"""The upper half of the status with which a bridge says that the source is gone."""
_NEVER: Final = -(1 << 63) - 1


class SequenceStep(Enum):
    """What a sequence number says of a message."""

    TAKEN = "taken"
    DUPLICATE = "duplicate"
    LATE = "late"


class RemoteWriter:
    """One DataSetWriter that was heard. The attributes up to `stale` are there for status displays."""

    __slots__ = (
        "_back_since",
        "_back_timestamp",
        "_counters",
        "_handed_on_alive",
        "_missing",
        "alive_at",
        "attested_at",
        "confirmed_number",
        "doubted",
        "duplicates",
        "entry",
        "expected",
        "failed",
        "gaps",
        "handed_on",
        "has_appeared",
        "has_said",
        "heard_major",
        "heard_timestamp",
        "is_gone",
        "key",
        "last_frame",
        "last_heard",
        "late",
        "major",
        "max_age_s",
        "metadata",
        "minor",
        "received",
        "restarts",
        "said_at",
        "says_max_age",
        "silences",
        "silent",
        "stale",
        "stated",
        "topic",
        "types",
    )

    def __init__(self, topic: Topic, now: float, counters: Counters) -> None:
        self.topic = topic
        self.metadata: DataSetMetaData | None = None
        """Metadata of its last message; None while it is not known."""
        self.received = 0
        """DataSetMessages handed on or found to be repeats, and keep-alives."""
        self.gaps = 0
        """DataSetMessages that were missing when a newer one came."""
        self.late = 0
        """Those of them that came after it."""
        self.duplicates = 0
        self.restarts = 0
        self.failed = 0
        """DataSetMessages that could not be made use of: not valid, of an unknown version, or with other fields."""
        self.silences = 0
        """How often it fell silent."""
        self.last_heard = now
        """When a message came that fitted the sequence, whatever became of it."""
        self.silent = False
        """Whether nothing was taken for MessageReceiveTimeout."""
        self.stale = False
        """Whether it is there, but nothing says that its last value is of now."""

        self.entry = 0
        """Number of its valid deadline."""
        self.alive_at = now
        self.attested_at = now
        """When its last value was of now."""
        self.max_age_s: float | None = None
        """How long its value counts as one of now; None for as long as it is attested."""
        self.says_max_age = False
        """Whether the writer knows its maximum age itself, and says when its value is too old."""
        self.said_at = now
        """When a value was handed on."""
        self.has_said = False
        """Whether a value was handed on."""
        self.has_appeared = False
        """Whether it was told that it is there: a value was handed on, or a keep-alive has come."""
        self.doubted = False
        """Whether it may have another value than the last one handed on: something was dropped, or it began anew."""
        self.is_gone = False
        """Whether what was handed on last is the news that the source is gone."""
        self.key: tuple[PublisherKey, int] = (topic.space, topic.id)
        """PublisherId and DataSetWriterId, as announcements and probes name it."""
        self.stated: DataSetMetaData | None = None
        """What its messages hold, where that is configured: then it announces nothing."""
        self.major: int | None = UNBOUND
        """Version in the header of the messages that `metadata` describes; None where the header has none."""
        self.minor: int | None = UNBOUND
        self.types: tuple[int, ...] = ()
        self.expected: int | None = None
        """The next sequence number."""
        self.heard_major: int | None = None
        self.heard_timestamp = _NEVER
        """The latest Timestamp since the writer's start."""
        self.handed_on = _NEVER
        """The Timestamp that was last handed on."""
        self.last_frame: DataSetMessage | None = None
        """What delta frames change, and ..."""
        self.confirmed_number: int | None = None
        """... the sequence number up to which it is what the writer has."""
        self._handed_on_alive = _NEVER
        """The same, of what was not the news that the source is gone."""
        self._missing: MissingNumbers | None = None
        self._back_since: float | None = None
        self._back_timestamp = _NEVER
        self._counters = counters

    def follow(self, message: DataSetMessage, now: float, receive_timeout_s: float) -> SequenceStep:
        """Follow the sequence with a key, delta or event frame."""
        number = message.sequence_number
        if number is None:
            return SequenceStep.TAKEN
        expected = self.expected
        if expected is None:
            self._start(number, message)
            return SequenceStep.TAKEN
        missing = (number - expected) & MASK
        later_version = self._is_later_version(message)
        if missing < NEWEST_STEP and not (missing and later_version):
            self._skip(expected, missing)
            self.expected = (number + 1) & MASK
            self._hear(message)
            return SequenceStep.TAKEN
        timestamp = message.timestamp
        if timestamp == self.handed_on:
            self._back_since = None  # as in is_new
        is_latest = timestamp is not None and timestamp > self.heard_timestamp
        if not later_version and self._missing is not None and self._missing.arrived(number, expected):
            self.late += 1
            if not is_latest and message.kind != FrameKind.EVENT:
                return SequenceStep.LATE
            self._hear(message)
            return SequenceStep.TAKEN
        if later_version or is_latest or now - self.last_heard > receive_timeout_s:
            self.restarts += 1
            self._start(number, message)
            return SequenceStep.TAKEN
        self.duplicates += 1
        return SequenceStep.DUPLICATE

    def follow_keep_alive(self, message: DataSetMessage, now: float, receive_timeout_s: float) -> bool:
        """Follow the sequence with a keep-alive, whose number is the next expected one; False if it is an old one."""
        number = message.sequence_number
        if number is None or number == self.expected:
            return True
        if self.expected is None:
            self._start(number - 1, message)
            return True
        missing = (number - self.expected) & MASK
        later_version = self._is_later_version(message)
        if missing < NEWEST_STEP and not later_version:
            self._skip(self.expected, missing)
            self.expected = number
            return True
        if later_version or now - self.last_heard > receive_timeout_s:
            self.restarts += 1
            self._start(number - 1, message)
            return True
        return False

    def is_new(self, timestamp: int, now: float, receive_timeout_s: float) -> bool:
        """Whether a message is new though its Timestamp is not later than the last one handed on.

        So it is where the source's clock was set back: for longer than the timeout we have heard nothing but past
        Timestamps that do not decrease. Without this, one time from the future would mute a source for ever. The
        values that were handed on last stay what they are, however often a restarted bridge sends them.
        """
        if timestamp == self.handed_on:
            # It is still being said: a past Timestamp beside it is that of another bridge of the same space, which
            # repeats its own last message with its own sequence.
            self._back_since = None
            return False
        if timestamp == self._handed_on_alive:
            return False
        if self._back_since is None or timestamp < self._back_timestamp:
            self._back_since = now
        self._back_timestamp = timestamp
        return now - self._back_since > receive_timeout_s

    def may_be_set_back(self, frame: DataSetMessage, now: float) -> bool:
        """Whether a message that is not new follows another one of a past Timestamp, as where a clock was set back."""
        is_there = (frame.status or 0) >> 16 != NO_COMMUNICATION
        return is_there and self._back_since is not None and self._back_since < now

    def hand_on(self, message: DataSetMessage) -> None:
        """Note that a message is handed on."""
        timestamp = message.timestamp
        if timestamp is not None:
            self.handed_on = timestamp
            if (message.status or 0) >> 16 != NO_COMMUNICATION:
                self._handed_on_alive = timestamp
            self._back_since = None
        self.last_frame = message
        self.is_gone = (message.status or 0) >> 16 == NO_COMMUNICATION
        self.has_said = self.has_appeared = True
        self.doubted = False
        self.confirmed_number = message.sequence_number

    def repeats(self, frame: DataSetMessage) -> bool:
        """Whether a message that is not new says the value that was handed on last, and not that its source is gone.

        Another old Timestamp says nothing: it may be that of a clock that was set back, and the value another one.
        """
        timestamp = frame.timestamp
        if timestamp != self.handed_on and timestamp != self._handed_on_alive:
            return False
        self.is_gone = (frame.status or 0) >> 16 == NO_COMMUNICATION
        self.doubted = False
        self.confirmed_number = frame.sequence_number
        return not self.is_gone

    def is_sure(self, number: int | None) -> bool:
        """Whether the value that was handed on last, if any was, is what the writer has before it sends `number`."""
        if not self.has_said:
            return True
        if self.doubted or self.is_gone:
            return False
        return number is None or self.confirmed_number == (number - 1) & MASK

    def is_of_another_version(self, message: DataSetMessage) -> bool:
        """Whether a message is of another life of the publisher than what was taken last, though its number fits."""
        taken = None if self.last_frame is None else self.last_frame.major_version
        return None not in (taken, message.major_version) and taken != message.major_version

    def confirm(self, number: int | None) -> None:
        """Note a message that changes nothing, so that a delta frame after it fits."""
        if number is not None and self.confirmed_number == (number - 1) & MASK:
            self.confirmed_number = number

    def base_of(self, delta: DataSetMessage) -> DataSetMessage | None:
        """The frame that a delta frame changes; None if something is missing between."""
        number = delta.sequence_number
        is_missing = self.doubted if number is None else self.confirmed_number != (number - 1) & MASK
        if is_missing:
            self.last_frame = None
        return self.last_frame

    def _is_later_version(self, message: DataSetMessage) -> bool:
        major, before = message.major_version, self.heard_major
        return major is not None and before is not None and major > before

    def _hear(self, message: DataSetMessage) -> None:
        if message.timestamp is not None and message.timestamp > self.heard_timestamp:
            self.heard_timestamp = message.timestamp
        if message.major_version is not None:
            self.heard_major = message.major_version

    def _start(self, number: int, message: DataSetMessage) -> None:
        self.expected = (number + 1) & MASK
        self.doubted = True
        self.heard_timestamp = _NEVER
        self._hear(message)
        self.last_frame = None
        if self._missing is not None:
            self._missing.clear()

    def _skip(self, first: int, missing: int) -> None:
        if missing:
            self.gaps += missing
            self._counters.gaps += missing
            if self._missing is None:
                self._missing = MissingNumbers()
            self._missing.skipped(first, missing)
