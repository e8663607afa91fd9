"""The metadata by which JSON is read and written: fields have names there, and places in UADP.

What strangers announce is bounded in number and memory. Where there is no room, what nobody has sent data for goes
first, and the oldest of it; what has data gives way to nobody.
"""

from __future__ import annotations

from typing import Final

from ua_fleet.pubsub.catalog import metadata_size
from ua_fleet.transport.mqtt.json.action_fields import ActionFields
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement
from ua_fleet.wire.json import DataSetFields
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, MetaDataAnnouncement

__all__ = ["Descriptions"]

MOST: Final = 10_000
MOST_BYTES: Final = 32 * 1024 * 1024

_Key = tuple[str, int]
"""PublisherId as text, and DataSetWriterId."""


class _Entry:
    __slots__ = ("_actions", "_fields", "action", "is_used", "metadata", "name", "size")

    def __init__(
        self, name: str | None, metadata: DataSetMetaData, action: ActionMetaDataAnnouncement | None, size: int
    ) -> None:
        self.name, self.metadata, self.action = name, metadata, action
        self.size = max(metadata_size(metadata) + (0 if action is None else metadata_size(action.response)), size)
        self.is_used = False
        self._fields: DataSetFields | None = None
        self._actions: ActionFields | None = None

    def fields(self) -> DataSetFields:
        """Planned when they are needed first: that takes more than an announcement is worth."""
        self.is_used = True
        if self._fields is None:
            self._fields = DataSetFields(self.metadata)
        return self._fields

    def actions(self, action: ActionMetaDataAnnouncement) -> ActionFields:
        """The same of an Action."""
        self.is_used = True
        if self._actions is None:
            self._actions = ActionFields(action)
        return self._actions


class Descriptions:
    """What was announced of DataSetWriters, by (PublisherId, DataSetWriterId)."""

    def __init__(self, *, most: int = MOST, most_bytes: int = MOST_BYTES) -> None:
        """Know nothing yet; `most` and `most_bytes` are the bounds."""
        self._most, self._most_bytes = most, most_bytes
        self._entries: dict[_Key, _Entry] = {}
        self._unused: dict[_Key, None] = {}
        """In the order of their announcements."""
        self._ids: dict[tuple[str, str], int] = {}
        """By PublisherId and DataSetWriterName."""
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def bytes(self) -> int:
        """About the memory of what was announced."""
        return self._bytes

    def learn(
        self,
        announcement: MetaDataAnnouncement | ActionMetaDataAnnouncement,
        name: str | None = None,
        *,
        is_fresh: bool = True,
        size: int = 0,
    ) -> bool:
        """Take an announcement; False if there is no room, or if a broker has kept it and a later one is known.

        `name` is that of the DataSetWriter. `size` is the bytes of the announcement: it takes as much memory at least.
        """
        action = announcement if isinstance(announcement, ActionMetaDataAnnouncement) else None
        metadata = announcement.metadata if isinstance(announcement, MetaDataAnnouncement) else announcement.request
        key = str(announcement.publisher_id), announcement.data_set_writer_id
        known = self._entries.get(key)
        if known is not None:
            if not is_fresh and known.metadata.configuration_version > metadata.configuration_version:
                return False
            if (known.metadata, known.action, known.name) == (metadata, action, name):
                return True
            self._remove(key, known)
        entry = _Entry(name, metadata, action, size)
        if not self._make_room(entry.size):
            return False
        self._entries[key] = entry
        self._bytes += entry.size
        self._unused[key] = None
        if name is not None:
            self._ids[key[0], name] = key[1]
        return True

    def fields(self, publisher: str, writer_id: int) -> DataSetFields | None:
        """The fields of a DataSetWriter; raises RemoteWireError where its metadata contradicts itself."""
        entry = self._used(publisher, writer_id)
        return None if entry is None or entry.action is not None else entry.fields()

    def actions(self, publisher: str, writer_id: int) -> ActionFields | None:
        """The fields of an Action; raises RemoteWireError where its metadata contradicts itself."""
        entry = self._used(publisher, writer_id)
        return None if entry is None or entry.action is None else entry.actions(entry.action)

    def version(self, publisher: str, writer_id: int) -> ConfigurationVersion | None:
        """The version of what is known of a DataSetWriter."""
        entry = self._entries.get((publisher, writer_id))
        return None if entry is None else entry.metadata.configuration_version

    def writer_id(self, publisher: str, name: str) -> int | None:
        """The DataSetWriterId of a DataSetWriterName."""
        return self._ids.get((publisher, name))

    def _used(self, publisher: str, writer_id: int) -> _Entry | None:
        key = publisher, writer_id
        self._unused.pop(key, None)
        return self._entries.get(key)

    def _make_room(self, size: int) -> bool:
        while len(self._entries) >= self._most or self._bytes + size > self._most_bytes:
            if not self._unused:
                return False
            oldest = next(iter(self._unused))
            self._remove(oldest, self._entries[oldest])
        return True

    def _remove(self, key: _Key, entry: _Entry) -> None:
        del self._entries[key]
        self._unused.pop(key, None)
        self._bytes -= entry.size
        if entry.name is not None and self._ids.get((key[0], entry.name)) == key[1]:
            del self._ids[key[0], entry.name]
