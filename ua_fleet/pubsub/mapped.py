"""DataSetWriters of publishers that are no bridges, each as a data source of the fleet.

A bridge's PublisherId is its space, and its WriterGroupId and DataSetWriterId are the node. Others have what their
makers chose: any type of PublisherId, any WriterGroupId or none. `sources` of `fleet.yaml` says which node each of them
is, and the fields of its messages where it does not announce them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMetaData, PublisherIdType

__all__ = ["MappedSource", "MappedSources", "PublisherKey", "publisher_key"]

PublisherKey = int | tuple[int, int | str]
"""A PublisherId that is a UInt16, or the type of another one with its value."""


def publisher_key(publisher_id_type: int, publisher_id: int | str) -> PublisherKey:
    """How a publisher is called here."""
    if publisher_id_type == PublisherIdType.UINT16 and isinstance(publisher_id, int):
        return publisher_id
    return (publisher_id_type, publisher_id)


class MappedSource(NamedTuple):
    """One DataSetWriter of somebody else."""

    publisher: PublisherKey
    writer_group_id: int | None
    data_set_writer_id: int
    topic: Topic
    """The data source that it is."""
    metadata: DataSetMetaData | None = None
    """What its messages hold; None where it announces that."""


class MappedSources:
    """All of them, by what stands in their messages."""

    def __init__(self, sources: Iterable[MappedSource] = ()) -> None:
        self._sources = {(source[0], source[1], source[2]): source for source in sources}
        self._publishers = frozenset([source.publisher for source in self._sources.values()])
        self.topics = frozenset([source.topic for source in self._sources.values()])
        """The data sources that they are. Nobody else is one of these."""
        self.stated = frozenset(
            [
                (source.publisher, source.data_set_writer_id)
                for source in self._sources.values()
                if source.metadata is not None and isinstance(source.publisher, int)
            ]
        )
        """PublisherIds and DataSetWriterIds of those that announce nothing."""

    def __bool__(self) -> bool:
        return bool(self._sources)

    def knows(self, publisher: PublisherKey) -> bool:
        """Whether any DataSetWriter of a publisher is mapped."""
        return publisher in self._publishers

    def find(
        self, publisher: PublisherKey, writer_group_id: int | None, data_set_writer_id: int
    ) -> MappedSource | None:
        """The source that a DataSetWriter is, or None."""
        return self._sources.get((publisher, writer_group_id, data_set_writer_id))
