"""What a DataSetWriter is set to send, where that is not a key frame of Variants each time (OPC 10000-14 6.2.4).

RawData      fields without types, as the metadata says; a message in which a field has no value goes as Variants,
             since RawData could only say a default value in its place
delta frame  the fields that have changed since the message before. A key frame goes instead where none has changed,
             where it is not longer, where types differ, and `key_frame_count - 1` messages after the last one
event        all fields, once: it is no state, and is never repeated
"""

from __future__ import annotations

from collections.abc import Iterable
from struct import Struct
from typing import Any, Final, NamedTuple

from ua_fleet.errors import LocalWireError
from ua_fleet.pubsub.metadata import type_codes
from ua_fleet.topics import Topic
from ua_fleet.wire import Codec
from ua_fleet.wire.builtin import MISFITS
from ua_fleet.wire.messages import (
    DataSetMessage,
    DataSetMetaData,
    FieldEncoding,
    FrameKind,
    NetworkMessage,
    PublisherIdType,
)
from ua_fleet.wire.raw import encode_raw_field
from ua_fleet.wire.variant import encode_typed

__all__ = ["PLAIN", "Frame", "FrameMaker", "WriterSettings"]

_COUNT: Final = Struct("<H")
_HEAD_BYTES: Final = 22
"""Of a DataSetMessage of ours: flags 2, sequence number 2, Timestamp 8, status 2, versions 8."""


class WriterSettings(NamedTuple):
    """How one DataSetWriter sends."""

    encoding: FieldEncoding = FieldEncoding.VARIANT
    """Variants or RawData."""
    key_frame_count: int = 1
    """KeyFrameCount (6.2.4.3): of so many messages at least one is a key frame."""
    are_events: bool = False
    """Whether its messages are events, which are never repeated."""


PLAIN: Final = WriterSettings()


class Frame(NamedTuple):
    """One message that was made and is not sent yet."""

    datagram: bytes
    is_key: bool
    size: int
    """Bytes that a key frame with these values has, without the NetworkMessage's header."""
    types: tuple[int, ...]
    fields: list[bytes]
    """Each field as it is encoded: what the next message is compared with."""


class FrameMaker:
    """Makes the messages of one DataSetWriter with one ConfigurationVersion."""

    def __init__(self, topic: Topic, metadata: DataSetMetaData, settings: WriterSettings, codec: Codec) -> None:
        self._topic, self._metadata, self._settings, self._codec = topic, metadata, settings, codec
        self._types = type_codes(metadata.fields)
        self._sent: Frame | None = None
        """The last message."""
        self._since_key = 0
        """Delta frames since the last key frame."""

    def make(self, number: int, timestamp: int, status: int, types: tuple[int, ...], values: tuple[Any, ...]) -> Frame:
        """The next message; nothing has changed before `taken`. Raises LocalWireError for values that do not fit."""
        if self._settings.are_events:
            message = self._message(number, timestamp, status)._replace(
                kind=FrameKind.EVENT.value, types=types, values=values
            )
            return Frame(self._datagram(message), True, 0, types, [])
        is_raw = self._is_raw(types)
        fields = self._fields(types, values)
        whole = sum(map(len, fields)) + (0 if is_raw else _COUNT.size)
        changed = self._changed(types, fields)
        if changed is not None and _COUNT.size + sum(_COUNT.size + len(fields[index]) for index in changed) >= whole:
            changed = None
        message = self._message(number, timestamp, status)
        if changed is None:
            message = self._key_frame(message, types, values, fields)
        else:
            message = message._replace(kind=FrameKind.DELTA.value, indices=changed)
            if is_raw:
                each = b"".join([_COUNT.pack(index) + fields[index] for index in changed])
                message = _raw(message, _COUNT.pack(len(changed)) + each)
            else:
                of_changed = tuple([types[index] for index in changed]), tuple([values[index] for index in changed])
                message = message._replace(types=of_changed[0], values=of_changed[1])
        return Frame(self._datagram(message), changed is None, _HEAD_BYTES + whole, types, fields)

    def taken(self, frame: Frame) -> None:
        """A message is sent: the next one is compared with it."""
        self._sent = frame
        self._since_key = 0 if frame.is_key else self._since_key + 1

    def forget(self) -> None:
        """The next message is compared with nothing: a value that was not sent stands between."""
        self._sent, self._since_key = None, 0

    def repeat(
        self, number: int, timestamp: int, status: int, types: tuple[int, ...], values: tuple[Any, ...]
    ) -> DataSetMessage:
        """The last message once more, as a key frame."""
        self._since_key = 0
        fields = self._sent.fields if self._sent is not None else self._fields(types, values)
        return self._key_frame(self._message(number, timestamp, status), types, values, fields)

    def _is_raw(self, types: tuple[int, ...]) -> bool:
        return self._settings.encoding is FieldEncoding.RAW_DATA and types == self._types

    def _fields(self, types: tuple[int, ...], values: tuple[Any, ...]) -> list[bytes]:
        if len(values) != len(types):
            raise LocalWireError(f"{self._topic.name}: {len(values)} values for {len(types)} fields")
        try:
            if self._is_raw(types):
                return [*map(encode_raw_field, self._metadata.fields, values)]
            return [_variant(code, value) for code, value in zip(types, values, strict=True)]
        except MISFITS as error:
            raise LocalWireError(f"{self._topic.name}: a value does not fit: {error}") from error

    def _changed(self, types: tuple[int, ...], fields: Iterable[bytes]) -> tuple[int, ...] | None:
        """The fields that a delta frame would have; None where it is time for a key frame, or for no delta frame."""
        sent = self._sent
        if sent is None or sent.types != types or self._since_key + 1 >= self._settings.key_frame_count:
            return None
        return tuple([i for i, (new, old) in enumerate(zip(fields, sent.fields, strict=True)) if new != old]) or None

    def _message(self, number: int, timestamp: int, status: int) -> DataSetMessage:
        version = self._metadata.configuration_version
        return DataSetMessage(
            self._topic.id,
            kind=FrameKind.KEY.value,
            sequence_number=number,
            timestamp=timestamp,
            status=status,
            major_version=version.major,
            minor_version=version.minor,
        )

    def _key_frame(
        self, message: DataSetMessage, types: tuple[int, ...], values: tuple[Any, ...], fields: Iterable[bytes]
    ) -> DataSetMessage:
        if self._is_raw(types):
            return _raw(message, b"".join(fields))
        return message._replace(types=types, values=values)

    def _datagram(self, message: DataSetMessage) -> bytes:
        space, ns, _ = self._topic
        return self._codec.encode(
            NetworkMessage(space, PublisherIdType.UINT16.value, writer_group_id=ns, messages=(message,))
        )


def _raw(message: DataSetMessage, data: bytes) -> DataSetMessage:
    return message._replace(encoding=FieldEncoding.RAW_DATA.value, raw=data)


def _variant(code: int, value: Any) -> bytes:
    out = bytearray()
    encode_typed(out, code, value)
    return bytes(out)
