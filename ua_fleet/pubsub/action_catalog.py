"""The Actions that were announced: what a requestor can ask, of whom, and with which fields."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from ua_fleet.errors import LocalWireError
from ua_fleet.wire import encode_announcement
from ua_fleet.wire.discovered import ActionMetaDataAnnouncement

__all__ = ["ActionCatalog"]

_MOST_BYTES: Final = 16 * 1024 * 1024

_Key = tuple[int | str | None, int]


class ActionCatalog:
    """The newest ActionMetaData by (PublisherId, DataSetWriterId), bounded in number and in bytes.

    Where there is too much, what was not announced for the longest time goes: a Responder that lives announces again.
    """

    def __init__(self, *, most: int = 4096, most_bytes: int = _MOST_BYTES) -> None:
        """Make an empty catalog.

        Args:
            most: DataSetWriters with Actions that are known at a time.
            most_bytes: of all their announcements together.
        """
        self._most, self._most_bytes = most, most_bytes
        self._actions: dict[_Key, ActionMetaDataAnnouncement] = {}
        """What was announced longest ago first."""
        self._sizes: dict[_Key, int] = {}
        self._bytes = 0

    @property
    def actions(self) -> Mapping[_Key, ActionMetaDataAnnouncement]:
        """All Actions that can be asked for; a live view."""
        return MappingProxyType(self._actions)

    def find(self, publisher_id: int | str | None, data_set_writer_id: int) -> ActionMetaDataAnnouncement | None:
        """The Actions of a DataSetWriter, or None."""
        return self._actions.get((publisher_id, data_set_writer_id))

    def apply(self, announcement: ActionMetaDataAnnouncement) -> bool:
        """Take an announcement in place of the one before; says whether anything but its number is new.

        One without targets retires the Action. One whose name or version differ between request and response is not
        taken: it could not be known which fields a message has.
        """
        key = announcement.publisher_id, announcement.data_set_writer_id
        request, response = announcement.request, announcement.response
        version = request.configuration_version
        if request.name != response.name or version != response.configuration_version:
            return False
        before = self._actions.pop(key, None)
        if before is not None:
            if before._replace(sequence_number=announcement.sequence_number) == announcement:
                self._actions[key] = announcement  # the latest heard of
                return False
            self._bytes -= self._sizes.pop(key)
        if not announcement.targets:
            return before is not None
        try:
            size = len(encode_announcement(announcement))
        except LocalWireError:  # fields of types that there are not: no request could be made of them
            return before is not None
        if size > self._most_bytes:
            return before is not None
        while self._actions and (len(self._actions) >= self._most or self._bytes + size > self._most_bytes):
            oldest = next(iter(self._actions))
            del self._actions[oldest]
            self._bytes -= self._sizes.pop(oldest)
        self._actions[key] = announcement
        self._sizes[key] = size
        self._bytes += size
        return True
