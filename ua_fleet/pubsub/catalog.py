"""The metadata that was announced, until the messages come that it describes.

An announcement names PublisherId and DataSetWriterId but no WriterGroup, so which writer it belongs to shows when a
message of that version comes.
"""

from __future__ import annotations

from typing import Final

from ua_fleet.pubsub.mapped import PublisherKey
from ua_fleet.pubsub.remote_writer import UNBOUND, RemoteWriter
from ua_fleet.values import LocalizedText
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

__all__ = ["Catalog", "metadata_size"]

_VERSIONS: Final = 4
"""Versions of one DataSetWriter that are remembered: messages of the one before may still be on their way."""

_METADATA_BYTES: Final = 500
_FIELD_BYTES: Final = 300
_ELEMENT_BYTES: Final = 50
_BYTES_FOR_ONE: Final = 1_000
"""Memory for each DataSetWriter that there may be: metadata of one field takes about so much."""
_BYTES_FOR_ONE_HEARD: Final = 2_000
"""The same for those that were heard: several fields."""

_Key = tuple[PublisherKey, int]


def metadata_size(metadata: DataSetMetaData) -> int:
    """About the memory that metadata takes, in bytes."""
    described = [(field.name, field.description) for one in metadata.structures for field in one.fields]
    described += [(field.name, field.description) for one in metadata.enumerations for field in one.fields]
    return (
        _METADATA_BYTES
        + len(metadata.name)
        + _text(metadata.description)
        + sum(map(len, metadata.namespaces))
        + sum(_FIELD_BYTES + len(name) + _text(description) for name, description in described)
        + _FIELD_BYTES * (len(metadata.structures) + len(metadata.enumerations) + len(metadata.simple_types))
        + sum(
            _FIELD_BYTES
            + len(field.name)
            + _text(field.description)
            + sum(_property_size(value) for _, _, value in field.properties)
            for field in metadata.fields
        )
    )


def _text(text: LocalizedText) -> int:
    return len(text.text or "") + len(text.locale or "")


def _property_size(value: object) -> int:
    if isinstance(value, str | bytes):
        return _FIELD_BYTES + len(value)
    return _FIELD_BYTES + (_ELEMENT_BYTES * len(value) if isinstance(value, tuple | list) else 0)  # pyright: ignore[reportUnknownArgumentType]


class _Entry:
    __slots__ = ("size", "versions", "writers")

    def __init__(self) -> None:
        self.size = 0
        """Memory of its versions."""
        self.versions: dict[ConfigurationVersion, DataSetMetaData] = {}
        """The newest announced last."""
        self.writers: list[RemoteWriter] = []
        """One, as DataSetWriterIds are unique in a publisher; several WriterGroups may break that rule."""


class Catalog:
    """Announced metadata by (PublisherId, DataSetWriterId), with a bound on what nobody has sent data for, and another.

    Of what was announced for writers that are heard nothing gives way to a newcomer: whoever comes when there is no
    room has no metadata, so that its messages are dropped and counted as such, and is asked for it again.
    """

    def __init__(self, max_orphans: int) -> None:
        self._entries: dict[_Key, _Entry] = {}
        self._orphans: dict[_Key, None] = {}
        self._max_orphans = max_orphans
        self._orphan_bytes, self._most_orphan_bytes = 0, max_orphans * _BYTES_FOR_ONE
        self._heard_bytes, self._most_heard_bytes = 0, max_orphans * _BYTES_FOR_ONE_HEARD

    def add_writer(self, writer: RemoteWriter) -> None:
        """Know a writer that was heard."""
        entry = self._entries.setdefault(writer.key, _Entry())
        if self._orphans.pop(writer.key, False) is None:
            self._orphan_bytes -= entry.size
        entry.writers.append(writer)
        if len(entry.writers) == 1:
            self._heard_bytes += entry.size
            self._make_fit(entry)

    def remove_writer(self, writer: RemoteWriter) -> None:
        """Forget a writer, and what was announced for it."""
        entry = self._entries[writer.key]
        entry.writers.remove(writer)
        if not entry.writers:
            self._heard_bytes -= entry.size
            del self._entries[writer.key]

    def writers(self, key: _Key) -> list[RemoteWriter]:
        """The writers that were heard under a (PublisherId, DataSetWriterId)."""
        entry = self._entries.get(key)
        return [] if entry is None else entry.writers

    def announced(self, key: _Key, metadata: DataSetMetaData, *, is_fresh: bool = True) -> bool:
        """Take an announcement; the oldest that no writer was heard for goes where there are too many.

        One that is not fresh, as a broker has kept it, is news where its version is the latest; says whether it was. An
        older one stands behind those that are known, for messages that name it.
        """
        entry = self._entries.get(key)
        version = metadata.configuration_version
        # No news, and it describes no message without a version. But messages of it come where the publisher's clock is
        # behind since its restart.
        is_older = not is_fresh and entry is not None and any(known > version for known in entry.versions)
        if is_older and entry is not None and (version in entry.versions or len(entry.versions) >= _VERSIONS):
            return False
        if entry is None:
            if len(self._orphans) >= self._max_orphans:
                self._forget_oldest()
            entry = self._entries[key] = _Entry()
            self._orphans[key] = None
        if entry.versions.get(version) == metadata:
            return True
        before = entry.size
        others = {known: entry.versions[known] for known in entry.versions if known != version}
        versions = entry.versions = {version: metadata, **others} if is_older else {**others, version: metadata}
        if len(versions) > _VERSIONS:
            del versions[next(iter(versions))]
        entry.size = sum(map(metadata_size, versions.values()))
        if entry.writers:
            self._heard_bytes += entry.size - before
            self._make_fit(entry)
        else:
            self._orphan_bytes += entry.size - before
            while self._orphan_bytes > self._most_orphan_bytes:
                self._forget_oldest()
        for writer in entry.writers:
            writer.major = UNBOUND
        return not is_older

    def _make_fit(self, entry: _Entry) -> None:
        """Forget the oldest versions of an entry until there is room for what is left, if anything."""
        while self._heard_bytes > self._most_heard_bytes and entry.versions:
            gone = metadata_size(entry.versions.pop(next(iter(entry.versions))))
            entry.size -= gone
            self._heard_bytes -= gone

    def _forget_oldest(self) -> None:
        """Forget what was announced first of what no writer was heard for. Who sends it is asked for it again."""
        oldest = next(iter(self._orphans))
        del self._orphans[oldest]
        self._orphan_bytes -= self._entries.pop(oldest).size

    def find(self, key: _Key, message: DataSetMessage) -> DataSetMetaData | None:
        """The newest metadata that fits the version in a message's header, as far as that has one."""
        entry = self._entries.get(key)
        if entry is None:
            return None
        major, minor = message.major_version, message.minor_version
        for version in reversed(entry.versions):
            if major in (None, version.major) and minor in (None, version.minor):
                return entry.versions[version]
        return None
