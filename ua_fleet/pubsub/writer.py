"""The state of one DataSetWriter, and the messages that it makes again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from ua_fleet.pubsub.layout import PLAIN, FrameMaker, WriterSettings
from ua_fleet.pubsub.metadata import max_age_s, type_codes, with_max_age
from ua_fleet.pubsub.packing import KEEP_ALIVE_BYTES
from ua_fleet.pubsub.sequence import MASK
from ua_fleet.topics import Topic
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData, FrameKind

__all__ = ["Encode", "Writer"]

Encode = Callable[[int, int, int, tuple[Any, ...]], bytes]
"""(sequence number, timestamp, status, values) -> the NetworkMessage."""

_KEY: Final = FrameKind.KEY.value
_KEEP_ALIVE: Final = FrameKind.KEEP_ALIVE.value


class Writer:
    """One DataSetWriter. The publisher decides when something is sent, this class what."""

    __slots__ = (
        "alive",
        "announce_at",
        "answer_pending",
        "answered_at",
        "encode",
        "entry",
        "failed",
        "is_off",
        "maker",
        "max_age_s",
        "metadata",
        "next_number",
        "repeat_at",
        "sent_at",
        "sent_types",
        "settings",
        "size",
        "status",
        "timestamp",
        "topic",
        "types",
        "values",
        "was_alive",
    )

    def __init__(self, topic: Topic, settings: WriterSettings = PLAIN) -> None:
        self.topic, self.settings = topic, settings
        self.metadata = DataSetMetaData("", (), ConfigurationVersion(0, 0))
        self.types: tuple[int, ...] = ()
        """The type codes that the metadata says."""
        self.encode: Encode | None = None
        """Encodes key frames of this version; None while retired."""
        self.maker: FrameMaker | None = None
        """Makes what is sent in place of `encode`, where something else than key frames of Variants is configured."""
        self.next_number = 0
        self.timestamp = -1
        """Timestamp of the last message; -1 before the first."""
        self.values: tuple[Any, ...] | None = None
        """The last message's values, None where there is nothing to repeat."""
        self.sent_types: tuple[int, ...] = ()
        self.status = 0
        self.size = 0
        """Bytes of the last message without the NetworkMessage's header."""
        self.alive = False
        self.is_off = False
        """Whether it is disabled, or what it is part of: it sends nothing, and keeps what it would have said last."""
        self.was_alive = False
        """Whether its source is alive while it is off."""
        self.failed = 0
        """DataSetMessages that could not be made."""
        self.sent_at = 0.0
        self.repeat_at = 0.0
        self.announce_at = 0.0
        self.answered_at = float("-inf")
        self.answer_pending = False
        self.max_age_s: float | None = None
        self.entry = 0
        """Number of the writer's valid entry in the publisher's heap of deadlines."""

    def lay_out(self, metadata: DataSetMetaData, codec: Codec) -> None:
        """Take new metadata. What was sent with other fields is not repeated any more."""
        if with_max_age(metadata.fields, None) != with_max_age(self.metadata.fields, None):
            self.values = None
        self.max_age_s = max_age_s(metadata.fields)
        self.metadata = metadata
        self.types = type_codes(metadata.fields)
        self.encode = self.encoder(self.types, codec)
        if self.settings != PLAIN:
            self.maker = FrameMaker(self.topic, metadata, self.settings, codec)

    def encoder(self, types: tuple[int, ...], codec: Codec) -> Encode:
        """What encodes this version's key frames with these type codes."""
        space, ns, writer_id = self.topic
        major, minor = self.metadata.configuration_version
        return codec.writer_plan(space, ns, writer_id, types, major, minor).encode

    def retire(self) -> None:
        """Forget the source, but for the numbers that must go on if it comes back."""
        self.alive = self.was_alive = False
        self.values = None
        self.encode = None

    def keep(self, types: tuple[int, ...], values: tuple[Any, ...], status: int, timestamp: int, size: int) -> None:
        """Take what is not sent while this is off: it is said when this is on again."""
        self.was_alive, self.timestamp, self.status = True, timestamp, status
        if not self.settings.are_events:
            self.values, self.sent_types, self.size = values, types, size
        if self.maker is not None:
            self.maker.forget()

    def turn_off(self) -> None:
        """Send nothing any more."""
        self.was_alive, self.alive, self.is_off = self.alive, False, True

    def turn_on(self, now: float) -> bool:
        """Send again what there is, soon; says whether there is a source to tell of."""
        self.alive, self.is_off = self.was_alive, False
        self.announce_at = self.repeat_at = now
        self.sent_at = float("-inf")
        return self.alive

    def keep_alive_period_s(self, keep_alive_s: float) -> float:
        """How often this writer has to say that it lives: twice within a maximum age, since that is what it attests."""
        return keep_alive_s if self.max_age_s is None else min(keep_alive_s, self.max_age_s / 2)

    def deadline(self, keep_alive_s: float) -> float:
        """When this writer has to send something next."""
        due = min(self.sent_at + self.keep_alive_period_s(keep_alive_s), self.announce_at)
        return due if self.values is None else min(due, self.repeat_at)

    def repeat(self) -> tuple[DataSetMessage, int]:
        """The last message again, with the next sequence number, and its size."""
        assert self.values is not None
        number = self.next_number
        self.next_number = (number + 1) & MASK
        version = self.metadata.configuration_version
        if self.maker is not None:
            message = self.maker.repeat(number, self.timestamp, self.status, self.sent_types, self.values)
            return message, self.size
        return DataSetMessage(
            self.topic.id,
            _KEY,
            self.sent_types,
            self.values,
            number,
            self.timestamp,
            None,
            self.status,
            version.major,
            version.minor,
        ), self.size

    def said_last(self) -> tuple[DataSetMessage, int]:
        """The last message with the number that it had, as a key frame; a keep-alive where there is none to repeat."""
        if self.values is None:
            return self.keep_alive()
        number, version = (self.next_number - 1) & MASK, self.metadata.configuration_version
        message = DataSetMessage(self.topic.id, _KEY, self.sent_types, self.values, number, self.timestamp)
        message = message._replace(status=self.status, major_version=version.major, minor_version=version.minor)
        return message, self.size

    def keep_alive(self) -> tuple[DataSetMessage, int]:
        """A keep-alive and its size; its sequence number is the next expected one (OPC 10000-14 7.2.4.5.8)."""
        version = self.metadata.configuration_version
        return DataSetMessage(
            self.topic.id,
            kind=_KEEP_ALIVE,
            sequence_number=self.next_number,
            major_version=version.major,
            minor_version=version.minor,
        ), KEEP_ALIVE_BYTES
