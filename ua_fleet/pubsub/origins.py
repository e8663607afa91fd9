"""Origins that a relay may speak for: publishers as a whole, or DataSetWriters of them. Pure.

A relay and those who hear it decide by the same list. What it names comes in at one place, and goes out at the other.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

from ua_fleet.topics import Topic
from ua_fleet.wire.discovered import StatusAnnouncement
from ua_fleet.wire.generic import Decoded
from ua_fleet.wire.messages import MetaDataAnnouncement, NetworkMessage, PublisherIdType

__all__ = ["NO_ORIGINS", "Direction", "Origins"]

_UINT16: Final = PublisherIdType.UINT16.value


class Origins:
    """See the module."""

    def __init__(self, spaces: Iterable[int] = (), sources: Iterable[Topic] = ()) -> None:
        """List them; of a space that is listed as a whole, single sources add nothing."""
        writers: dict[int, set[tuple[int, int]] | None] = dict.fromkeys(spaces)
        for space, ns, number in sources:
            listed = writers.setdefault(space, set())
            if listed is not None:
                listed.add((ns, number))
        self._writers: Mapping[int, frozenset[tuple[int, int]] | None] = {
            space: None if listed is None else frozenset(listed) for space, listed in writers.items()
        }
        self._ids = {
            space: frozenset([number for _, number in listed])
            for space, listed in self._writers.items()
            if listed is not None
        }

    def __bool__(self) -> bool:
        return bool(self._writers)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Origins) and self._writers == other._writers

    def __hash__(self) -> int:
        return hash(frozenset(self._writers.items()))

    def __or__(self, other: Origins) -> Origins:
        return Origins(self.wholes | other.wholes, [*self.sources, *other.sources])

    @property
    def publishers(self) -> frozenset[int]:
        """The spaces of which at least something is listed."""
        return frozenset(self._writers)

    @property
    def wholes(self) -> frozenset[int]:
        """The spaces that are listed as a whole."""
        return frozenset([space for space, listed in self._writers.items() if listed is None])

    @property
    def sources(self) -> tuple[Topic, ...]:
        """What is listed of the others, in order."""
        found = [(space, ns, number) for space, listed in self._writers.items() for ns, number in listed or ()]
        return tuple([Topic(*each) for each in sorted(found)])

    def names(self, publisher_id: int | str | None, publisher_id_type: int = _UINT16) -> bool:
        """Whether anything of a publisher is listed."""
        return publisher_id_type == _UINT16 and publisher_id in self._writers

    def has(self, publisher_id: int | str | None, writer_group_id: int | None, writer_id: int) -> bool:
        """Whether a DataSetWriter is listed."""
        if not isinstance(publisher_id, int) or publisher_id not in self._writers:
            return False
        listed = self._writers[publisher_id]
        return listed is None or (writer_group_id, writer_id) in listed

    def writer_ids(self, publisher_id: int) -> frozenset[int] | None:
        """The DataSetWriterIds of a publisher that are listed; None where it is listed as a whole."""
        return self._ids.get(publisher_id)

    def of(self, message: Decoded) -> Decoded | None:
        """What of a message of a listed publisher is listed; None for nothing, and for what no relay forwards.

        That is data, metadata and states. Who commands a publisher, what it can be asked for, and where it is found,
        nobody says in its name.
        """
        if type(message) is NetworkMessage:
            publisher, group = message.publisher_id, message.writer_group_id
            parts = tuple([part for part in message.messages if self.has(publisher, group, part.data_set_writer_id)])
            if len(parts) == len(message.messages):
                return message
            return message._replace(messages=parts) if parts else None
        if isinstance(message, MetaDataAnnouncement):
            ids = self._ids.get(message.publisher_id) if isinstance(message.publisher_id, int) else None
            return message if ids is None or message.data_set_writer_id in ids else None
        return message if isinstance(message, StatusAnnouncement) else None


NO_ORIGINS: Final = Origins()


class Direction(NamedTuple):
    """What a relay forwards from one of its connections to another; these are their numbers."""

    source: int
    target: int
    origins: Origins
