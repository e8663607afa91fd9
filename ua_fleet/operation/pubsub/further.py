"""The further PubSubConnections of a process that has several: by each goes what goes by its first one. Pure.

Each has an Object with its own address, profile and security, and with the WriterGroups and DataSetWriters as they are
on it, and what is counted of the connection itself, where its process tells. What is of the process stands at its first
PubSubConnection alone: the switches, the counters of groups and below, the DataSetReaders and the PublishedDataSets.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ua_fleet.operation.pubsub.bridges import MOST_GROUPS, AnnouncedConnection
from ua_fleet.operation.pubsub.connections import ServerConnection
from ua_fleet.operation.pubsub.description import (
    Description,
    Diagnostics,
    Live,
    describe_connection,
    describe_data_set,
    describe_writer,
    describe_writer_group,
)
from ua_fleet.operation.pubsub.difference import Part
from ua_fleet.pubsub.components import CONNECTION, Component, writer, writer_group
from ua_fleet.topics import Topic
from ua_fleet.wire.discovered import DataSetWriter, PubSubConnection, WriterGroup
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData

__all__ = ["FurtherConnection", "key_of_further"]


def key_of_further(first: str, name: str) -> str:
    """What the NodeIds of a further connection begin with, of the key of the first one and its own name."""
    return f"PubSub.connections.{first.removeprefix('PubSub.')}.{name}"


class FurtherConnection:
    """See ShownConnection. What it shows, its process's first connection knows."""

    has_data_sets = False

    def __init__(self, first: ServerConnection | AnnouncedConnection, name: str, number: int) -> None:
        """Show one.

        Args:
            first: of the same process.
            name: in `fleet.yaml`.
            number: the place among all connections of the process, from 1 on.
        """
        self.key = key_of_further(first.key, name)
        self._first, self._name, self._number = first, name, number

    def connection(self) -> Part | None:
        """See ShownConnection."""
        known, first = self._known(), self._first
        if known is None:
            return None
        # What a bridge calls itself is no name here: it could be that of another one.
        name = known.name if isinstance(first, ServerConnection) else f"bridge {first.name} {self._name}"
        return Part(name or self.key, (known._replace(enabled=True, writer_groups=()), self._diagnostics() is not None))

    def groups(self) -> Mapping[Component, Part]:
        """See ShownConnection."""
        return {
            writer_group(number): Part(group.name or str(number), group._replace(enabled=True, data_set_writers=()))
            for number, group in self._groups().items()
        }

    def members(self, group: Component) -> Mapping[Component, Part]:
        """See ShownConnection."""
        number = int(group[1])
        return {
            writer(number, each.data_set_writer_id): Part(
                each.name or str(each.data_set_writer_id), each._replace(enabled=True)
            )
            for each in self._writers(number)
        }

    def data_sets(self) -> Mapping[Topic, Part]:
        """See ShownConnection."""
        return {}

    def writers_of(self, topic: Topic) -> Iterable[Component]:
        """See ShownConnection."""
        del topic
        return ()

    def describe(self, component: Component) -> Description:
        """See ShownConnection."""
        state = self._state(component)
        if component == CONNECTION:
            known = self._known()
            assert known is not None
            return describe_connection(known, state, self._diagnostics(), can_switch=False)
        number = int(component[1])
        if component == writer_group(number):
            return describe_writer_group(self._groups()[number], state, None, can_switch=False)
        [own] = [each for each in self._writers(number) if each.data_set_writer_id == component[2]]
        return describe_writer(own, state, None, can_switch=False)

    def describe_data_set(self, topic: Topic) -> Description:
        """See ShownConnection."""
        return describe_data_set(lambda: DataSetMetaData(topic.name, (), ConfigurationVersion(0, 0)), None)

    def reset(self, component: Component) -> bool:
        """Begin to count anew; whether anything is counted there."""
        return component == CONNECTION and self._first.reset_further(self._number, self.key)

    def has_failed(self) -> bool:
        """Whether it is a connection of the server, and has counted an error."""
        diagnostics = self._diagnostics() if isinstance(self._first, ServerConnection) else None
        return diagnostics is not None and bool(diagnostics.total(errors=True))

    def _diagnostics(self) -> Diagnostics | None:
        return self._first.further_diagnostics(self._number, self.key)

    def _known(self) -> PubSubConnection | None:
        return self._first.further(self._number)

    def _groups(self) -> dict[int, WriterGroup]:
        known = self._known()
        groups = () if known is None else known.writer_groups[:MOST_GROUPS]
        return {each.writer_group_id: each for each in groups}

    def _writers(self, number: int) -> tuple[DataSetWriter, ...]:
        """Those of a group that the first connection has too, as it has a bound."""
        shown = self._first.members(writer_group(number))
        found = self._first.further_writers(self._number, number)
        return tuple([each for each in found if writer(number, each.data_set_writer_id) in shown])

    def _state(self, component: Component) -> Live:
        return self._first.further_state(self._number, component)
