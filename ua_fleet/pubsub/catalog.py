"""The metadata that was announced, until the messages come that it describes.

An announcement names PublisherId and DataSetWriterId but no WriterGroup, so which writer it belongs to shows when a
message of that version comes.
"""

from __future__ import annotations

from typing import Final

from ua_fleet.pubsub.mapped import PublisherKey
from ua_fleet.pubsub.remote_writer import UNBOUND, RemoteWriter
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData

__all__ = ["Catalog"]

_VERSIONS: Final = 4
"""Versions of one DataSetWriter that are remembered: messages of the one before may still be on their way."""

_Key = tuple[PublisherKey, int]


class _Entry:
    __slots__ = ("versions", "writers")

    def __init__(self) -> None:
        self.versions: dict[ConfigurationVersion, DataSetMetaData] = {}
        """The newest announced last."""
        self.writers: list[RemoteWriter] = []
        """One, as DataSetWriterIds are unique in a publisher; several WriterGroups may break that rule."""


class Catalog:
    """Announced metadata by (PublisherId, DataSetWriterId), with a bound on what nobody has sent data for."""

    def __init__(self, max_orphans: int) -> None:
        self._entries: dict[_Key, _Entry] = {}
        self._orphans: dict[_Key, None] = {}
        self._max_orphans = max_orphans

    def add_writer(self, writer: RemoteWriter) -> None:
        """Know a writer that was heard."""
        self._orphans.pop(writer.key, None)
        self._entries.setdefault(writer.key, _Entry()).writers.append(writer)

    def remove_writer(self, writer: RemoteWriter) -> None:
        """Forget a writer, and what was announced for it."""
        entry = self._entries[writer.key]
        entry.writers.remove(writer)
        if not entry.writers:
            del self._entries[writer.key]

    def writers(self, key: _Key) -> list[RemoteWriter]:
        """The writers that were heard under a (PublisherId, DataSetWriterId)."""
        entry = self._entries.get(key)
        return [] if entry is None else entry.writers

    def announced(self, key: _Key, metadata: DataSetMetaData) -> None:
        """Take an announcement; the oldest that no writer was heard for goes where there are too many."""
        entry = self._entries.get(key)
        if entry is None:
            if len(self._orphans) >= self._max_orphans:
                oldest = next(iter(self._orphans))
                del self._orphans[oldest], self._entries[oldest]
            entry = self._entries[key] = _Entry()
            self._orphans[key] = None
        versions = entry.versions
        version = metadata.configuration_version
        if versions.get(version) == metadata:
            return
        versions.pop(version, None)
        versions[version] = metadata
        if len(versions) > _VERSIONS:
            del versions[next(iter(versions))]
        for writer in entry.writers:
            writer.major = UNBOUND

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
