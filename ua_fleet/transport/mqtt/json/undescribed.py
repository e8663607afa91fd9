"""JSON values without metadata: kept as they came, and shown as their text where none comes.

    (new)    value            held: the last one waits for metadata
    held     metadata         -> the last value, decoded, unless it is too old
    held     LATE_S           shown: from then on each value is a DataSet with one field, a text
    shown    metadata         -> the same; the source has the fields of its metadata from then on

A frame of a shown source has no sequence number, and its Timestamp is 100 ns early: so the same value is new once more
when it comes with its fields. Delta frames and events are not shown: they are no value.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Final

from ua_fleet.pubsub.sequence import MASK
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldMetaData,
    FrameKind,
    MetaDataAnnouncement,
    PublisherIdType,
)

__all__ = ["LATE_S", "Undescribed"]

LATE_S: Final = 3.0
"""Retained metadata comes with the first messages of a connection."""
OLD_S: Final = 2 * LATE_S
"""A value that came so long before its metadata, and that no keep-alive attests, says nothing of now."""
MOST: Final = 1_000
MOST_BYTES: Final = 16 * 1024 * 1024
LONGEST_NAME: Final = 256
"""Characters of the name of a DataSetWriter that are kept."""
FIELD: Final = "json"
_VERSION: Final = ConfigurationVersion(1, 1)
"""Below every VersionTime of now, so that metadata which was retained is a later one."""
_STRING: Final = int(BuiltinType.STRING)

Shown = tuple[Topic, MetaDataAnnouncement, DataSetMessage]
"""What is said of a source that is shown as text."""


class _Held:
    __slots__ = ("at", "is_shown", "last", "may_show", "name", "number", "since")

    def __init__(self, name: str, since: float) -> None:
        self.name, self.since, self.at = name[:LONGEST_NAME], since, since
        self.last: DataSetMessage | None = None
        self.number: int | None = None
        self.is_shown, self.may_show = False, True

    @property
    def size(self) -> int:
        return 500 if self.last is None else 500 + len(self.last.raw or b"")


class Undescribed:
    """See the module."""

    def __init__(self, *, most: int = MOST, most_bytes: int = MOST_BYTES) -> None:
        """Hold nothing yet; of more than `most` sources or `most_bytes` those go that were silent for longest."""
        self._most, self._most_bytes = most, most_bytes
        self._held: OrderedDict[Topic, _Held] = OrderedDict()
        self._groups: dict[tuple[int, int], set[int]] = {}
        """The namespaces of what is held, by PublisherId and DataSetWriterId, which metadata names."""
        self._bytes = 0
        self.lost = 0
        """Values that nobody was told of, since this was set to 0."""

    def __bool__(self) -> bool:
        return bool(self._held)

    def __contains__(self, source: object) -> bool:
        return source in self._held

    @property
    def bytes(self) -> int:
        """About the memory of what is held."""
        return self._bytes

    def put(self, source: Topic, name: str, message: DataSetMessage, now: float, *, may_show: bool) -> list[Shown]:
        """Take a message whose payload stayed text.

        Args:
            source: of which it is.
            name: of its DataSetWriter.
            message: with its payload in `raw`, or a keep-alive.
            now: the time.
            may_show: False where its fields are known otherwise, or there is metadata of another version.
        """
        held = self._held.get(source)
        if message.kind == FrameKind.KEEP_ALIVE or (message.kind == FrameKind.KEY and message.raw == b"{}"):
            return [] if held is None else self._keep_alive(source, held, message, now)
        if message.kind != FrameKind.KEY:
            self.lost += 1
            return []
        if held is None:
            held = self._held[source] = _Held(name, now)
            self._groups.setdefault((source.space, source.id), set()).add(source.ns)
            self._bytes += held.size
        self._held.move_to_end(source)
        self._bytes -= held.size
        self.lost += held.last is not None and not held.is_shown
        # orjson's bytes keep the buffer that they were written into, which is ten times as large.
        held.last = message._replace(raw=bytes(memoryview(message.raw or b"")))
        held.number, held.at = message.sequence_number, now
        self._bytes += held.size
        while len(self._held) > self._most or self._bytes > self._most_bytes:
            self._forget(next(iter(self._held)))
        held.may_show = may_show
        held.is_shown = held.is_shown and may_show
        return [_shown(source, held)] if held.is_shown else []

    def described(self, publisher: int, writer_id: int, now: float) -> list[tuple[Topic, DataSetMessage]]:
        """The last values of a DataSetWriter, of which the metadata has come: they wait no more, and old ones go."""
        groups = self._groups.pop((publisher, writer_id), ())
        found = [source for ns in groups if (source := Topic(publisher, ns, writer_id)) in self._held]
        last: list[tuple[Topic, DataSetMessage]] = []
        for source in found:
            held = self._held.pop(source)
            self._bytes -= held.size
            if now - held.at > OLD_S:
                self.lost += not held.is_shown
            elif held.last is not None:
                last.append((source, held.last))
        return last

    def poll(self, now: float) -> list[Shown]:
        """What has waited for its metadata long enough, and is shown from now on."""
        shown: list[Shown] = []
        for source, held in self._held.items():
            if held.may_show and not held.is_shown and now - held.since >= LATE_S:
                held.is_shown = True
                shown.append(_shown(source, held))
        return shown

    def _keep_alive(self, source: Topic, held: _Held, message: DataSetMessage, now: float) -> list[Shown]:
        """Attest what is shown, unless something is missing between."""
        number = message.sequence_number
        if number is not None and held.number is not None and number != (held.number + 1) & MASK:
            return []
        if message.kind == FrameKind.KEY:  # a key frame without fields has a number of its own
            held.number = number
        held.at = now
        if not held.is_shown:
            return []
        keep_alive = DataSetMessage(
            source.id, FrameKind.KEEP_ALIVE.value, major_version=_VERSION.major, minor_version=_VERSION.minor
        )
        return [(source, _metadata(source, held), keep_alive)]

    def _forget(self, source: Topic) -> None:
        held = self._held.pop(source)
        self._bytes -= held.size
        groups = self._groups[source.space, source.id]
        groups.discard(source.ns)
        if not groups:
            del self._groups[source.space, source.id]
        self.lost += not held.is_shown


def _metadata(source: Topic, held: _Held) -> MetaDataAnnouncement:
    metadata = DataSetMetaData(held.name, (FieldMetaData(FIELD, _STRING),), _VERSION)
    return MetaDataAnnouncement(source.space, PublisherIdType.UINT16.value, 0, source.id, metadata)


def _shown(source: Topic, held: _Held) -> Shown:
    message = held.last
    assert message is not None
    frame = DataSetMessage(
        source.id,
        FrameKind.KEY.value,
        (_STRING,),
        ((message.raw or b"").decode(),),
        timestamp=None if message.timestamp is None else message.timestamp - 1,
        status=message.status,
        major_version=_VERSION.major,
        minor_version=_VERSION.minor,
    )
    return source, _metadata(source, held), frame
